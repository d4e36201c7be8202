"""Local fill: the hole beside a foreground disc must get the background behind it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import pytest

from orca.errors import BadInput, Unknown
from orca.repair.background import background_pixels
from orca.repair.components import Component, connected_components
from orca.repair.donors import FillTarget, local_fill
from orca.repair.membrane import linear_trend, membrane, mirrored_detail
from orca.repair.rules import RepairRules

RULES = RepairRules()
FOREGROUND_INVERSE = 0.7


@dataclass(frozen=True, eq=False)
class Scene:
    """A render with a hole, and what is really behind it."""

    rgb: np.ndarray
    depth: np.ndarray
    hole: np.ndarray
    true_rgb: np.ndarray
    true_depth: np.ndarray

    def fill(self, scheme: str = "smooth", rules: RepairRules = RULES) -> FillTarget:
        (component,) = connected_components(self.hole, 16)
        return local_fill(self.rgb, self.depth, ~self.hole, component, rules, scheme)  # type: ignore[arg-type]


def textured(height: int, width: int, seed: int, base: tuple[float, float, float]) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(0, 1, (height, width, 3)).astype(np.float32)
    return np.clip(np.float32(base) + 0.3 * cv2.GaussianBlur(noise, (0, 0), 3.0), 0, 1).astype(np.float32)


def disc_scene(
    angle: float, tilt: float, center: tuple[int, int] = (130, 100), size: tuple[int, int] = (200, 260)
) -> Scene:
    """A near disc over a tilted plane; the disc's shift by ``angle`` uncovers a crescent. NaN inside the hole."""
    height, width = size
    y, x = np.mgrid[0:height, 0:width] + 0.5
    direction = np.array([np.cos(angle), np.sin(angle)])
    inverse = 0.25 + tilt * ((x - width / 2) * direction[1] + (y - height / 2) * direction[0] * 0.5) / width
    disc = (x - center[0]) ** 2 + (y - center[1]) ** 2 < 40**2
    shift = 60.0 * (FOREGROUND_INVERSE - inverse)
    source_x, source_y = x - shift * direction[0], y - shift * direction[1]
    hole = ((source_x - center[0]) ** 2 + (source_y - center[1]) ** 2 < 40**2) & ~disc
    hole = cv2.morphologyEx(hole.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)).astype(bool)
    background = textured(height, width, 0, (0.2, 0.6, 0.3))
    soft = cv2.GaussianBlur(disc.astype(np.float32), (0, 0), 0.8)
    rgb = background * (1 - soft[..., None]) + textured(height, width, 1, (0.9, 0.2, 0.2)) * soft[..., None]
    true_depth = (1 / inverse).astype(np.float32)
    depth = (true_depth * (1 - soft) + soft / FOREGROUND_INVERSE).astype(np.float32)
    rgb[hole], depth[hole] = np.nan, np.nan
    return Scene(rgb.astype(np.float32), depth, hole, background, true_depth)


@pytest.mark.parametrize("scheme", ["paper", "smooth"])
@pytest.mark.parametrize("tilt", [0.0, 0.3])
@pytest.mark.parametrize("angle", np.linspace(0, 2 * np.pi, 8, endpoint=False))
def test_filled_hole_lies_behind_the_foreground(angle: float, tilt: float, scheme: str) -> None:
    scene = disc_scene(angle, tilt)
    target = scene.fill(scheme)
    true = 1 / scene.true_depth[target.y, target.x]
    inverse = 1 / target.depth
    assert np.mean(np.abs(inverse - true) < np.abs(inverse - FOREGROUND_INVERSE)) >= 0.97
    assert target.depth.min() > 1.0 / FOREGROUND_INVERSE
    to_background = np.linalg.norm(target.rgb - scene.true_rgb[target.y, target.x], axis=1)
    to_foreground = np.linalg.norm(target.rgb - np.float32([0.9, 0.2, 0.2]), axis=1)
    assert np.mean(to_background < to_foreground) >= 0.97


@pytest.mark.parametrize("angle", np.linspace(0, 2 * np.pi, 8, endpoint=False))
def test_smooth_continues_a_tilted_background_where_the_percentile_keeps_one_corner(angle: float) -> None:
    scene = disc_scene(angle, 0.3)
    error = {}
    for scheme in ("paper", "smooth"):
        target = scene.fill(scheme)
        error[scheme] = np.mean(np.abs(target.depth / scene.true_depth[target.y, target.x] - 1))
    assert error["smooth"] < 0.02
    assert error["smooth"] < 0.5 * error["paper"]


@pytest.mark.parametrize("center", [(20, 100), (245, 100), (130, 5), (130, 190), (10, 10)])
def test_a_hole_at_the_image_border_gets_the_background(center: tuple[int, int]) -> None:
    angle = np.arctan2(100 - center[1], 130 - center[0]) + 1.0
    scene = disc_scene(angle, 0.2, center)
    target = scene.fill()
    true = 1 / scene.true_depth[target.y, target.x]
    assert np.mean(np.abs(1 / target.depth - true) < np.abs(1 / target.depth - FOREGROUND_INVERSE)) >= 0.97


def test_foreground_colour_does_not_leak() -> None:
    """Flat colours: the fill is the background's colour exactly, and no donor is foreground."""
    scene = disc_scene(0.0, 0.0)
    disc = scene.depth < 2.0
    rgb = np.where(disc[..., None], np.float32([1, 0, 0]), np.float32([0, 1, 0])).astype(np.float32)
    flat = Scene(rgb, scene.depth, scene.hole, rgb, scene.true_depth)
    for scheme in ("paper", "smooth"):
        np.testing.assert_allclose(flat.fill(scheme).rgb, np.tile([0.0, 1.0, 0.0], (scene.hole.sum(), 1)), atol=1e-5)
    assert flat.fill().scheme == "smooth:background"


def test_pixels_are_the_components_and_values_are_in_range() -> None:
    scene = disc_scene(0.7, 0.3)
    target = scene.fill()
    (component,) = connected_components(scene.hole, 16)
    y, x = component.pixels()
    assert np.array_equal(target.y, y)
    assert np.array_equal(target.x, x)
    assert target.rgb.shape == (component.area, 3)
    assert target.depth.shape == (component.area,)
    assert target.rgb.dtype == target.depth.dtype == np.float32
    assert np.isfinite(target.rgb).all()
    assert (target.depth > 0).all()
    assert 0 <= target.rgb.min() <= target.rgb.max() <= 1
    again = scene.fill()
    assert np.array_equal(again.rgb, target.rgb)
    assert np.array_equal(again.depth, target.depth)


def test_only_the_ring_is_read() -> None:
    scene = disc_scene(0.0, 0.2)
    near = cv2.dilate(scene.hole.astype(np.uint8), np.ones((61, 61), np.uint8)).astype(bool)
    rgb, depth = scene.rgb.copy(), scene.depth.copy()
    rgb[~near], depth[~near] = 0.123, 99.0
    other = Scene(rgb, depth, scene.hole, scene.true_rgb, scene.true_depth)
    for scheme in ("paper", "smooth"):
        assert np.array_equal(other.fill(scheme).depth, scene.fill(scheme).depth)
        assert np.array_equal(other.fill(scheme).rgb, scene.fill(scheme).rgb)


def test_paper_donors_are_the_far_percentile_of_the_ring() -> None:
    """Checked against a search over all pixels."""
    scene = disc_scene(0.3, 0.3)
    target = scene.fill("paper")
    hole, pixels = np.argwhere(scene.hole), np.argwhere(~scene.hole)
    distance = np.sqrt(((pixels[:, None, :] - hole[None]) ** 2).sum(-1)).min(axis=1)
    ring = pixels[(distance >= 3) & (distance <= 28)]
    depth = scene.depth[ring[:, 0], ring[:, 1]]
    # cv2's 5x5 distance is within 2 % of the Euclidean one, so a few pixels at the ring's edges may differ.
    assert target.depth_threshold == pytest.approx(np.percentile(depth, 78), rel=0.01)
    assert target.donors == pytest.approx(0.22 * len(ring), rel=0.05)
    assert target.depth.min() >= target.depth_threshold * (1 - 1e-6)
    assert target.scheme == "paper:percentile"


@pytest.mark.parametrize(("count", "nearest"), [(31, True), (32, False)])
@pytest.mark.parametrize("scheme", ["paper", "smooth"])
def test_fewer_donors_than_the_minimum_fall_back_to_the_nearest(scheme: str, count: int, nearest: bool) -> None:
    rgb, depth = textured(64, 64, 0, (0.5, 0.5, 0.5)), np.full((64, 64), 3.0, np.float32)
    hole = np.zeros((64, 64), bool)
    hole[30:34, 30:34] = True
    valid = np.zeros((64, 64), bool)
    valid[20, 10 : 10 + count] = True
    (component,) = connected_components(hole)
    target = local_fill(rgb, depth, valid, component, RULES, scheme)  # type: ignore[arg-type]
    assert target.is_nearest == nearest
    if nearest:
        assert target.scheme == f"{scheme}:nearest"
        np.testing.assert_array_equal(target.rgb[0], rgb[20, 30])  # straight above pixel (30, 30)
    else:
        assert target.donors == count


def test_without_a_ring_the_nearest_valid_pixel_anywhere_is_used() -> None:
    rgb, depth = np.zeros((60, 200, 3), np.float32), np.full((60, 200), 7.0, np.float32)
    rgb[:, 199] = (0.25, 0.5, 0.75)
    depth[:, 199] = 5.0
    hole = np.zeros((60, 200), bool)
    hole[20:30, 20:30] = True
    valid = np.zeros((60, 200), bool)
    valid[:, 199] = True
    (component,) = connected_components(hole)
    target = local_fill(rgb, depth, valid, component, RULES)
    assert target.scheme == "structure:nearest"
    assert np.unique(target.depth).tolist() == [5.0]
    assert np.unique(target.rgb, axis=0).tolist() == [[0.25, 0.5, 0.75]]
    assert target.donors == 10


@pytest.mark.parametrize("scheme", ["paper", "smooth"])
@pytest.mark.parametrize("position", [(0, 0), (0, 20), (31, 55), (15, 30)])
def test_a_single_pixel_anywhere(position: tuple[int, int], scheme: str) -> None:
    rgb, depth = np.full((32, 56, 3), 0.4, np.float32), np.full((32, 56), 2.0, np.float32)
    component = Component(np.ones((1, 1), bool), (position[1], position[0], position[1] + 1, position[0] + 1))
    target = local_fill(rgb, depth, np.ones((32, 56), bool), component, RULES, scheme)  # type: ignore[arg-type]
    assert (target.y.tolist(), target.x.tolist()) == ([position[0]], [position[1]])
    assert target.depth[0] == pytest.approx(2.0)
    np.testing.assert_allclose(target.rgb[0], 0.4, atol=1e-6)


def test_ground_that_comes_closer_is_not_taken_for_foreground() -> None:
    """A band along the border (the camera panned): all of a steep floor stays a donor, and is continued as a plane."""
    y, x = np.mgrid[0:200, 0:150] + 0.5
    inverse = (0.1 + 0.004 * y + 0.0005 * x).astype(np.float32)
    hole = x > 120
    ring = (x > 92) & ~hole
    assert np.array_equal(background_pixels(1 / inverse, ring, hole, 28), ring)
    scene = Scene(textured(200, 150, 0, (0.5, 0.5, 0.5)), 1 / inverse, hole, np.empty(0), 1 / inverse)
    target = scene.fill()
    assert target.scheme == "smooth:all"
    error = np.abs(target.depth / scene.true_depth[target.y, target.x] - 1)
    assert np.mean(error < 1e-3) > 0.98
    assert error.max() < 0.02  # the lowest rows: nothing is placed nearer than the nearest donor


def test_invalid_input_is_refused() -> None:
    scene = disc_scene(0.0, 0.0)
    (component,) = connected_components(scene.hole, 16)
    rgb, depth, valid = scene.rgb, scene.depth, ~scene.hole
    with pytest.raises(BadInput, match="without a single valid pixel"):
        local_fill(rgb, depth, np.zeros_like(valid), component, RULES)
    with pytest.raises(BadInput, match="without a single valid pixel"):
        local_fill(rgb, np.full_like(depth, np.nan), valid, component, RULES)
    everything = Component(np.ones_like(valid), (0, 0, valid.shape[1], valid.shape[0]))
    with pytest.raises(BadInput, match="without a single valid pixel"):
        local_fill(rgb, depth, np.ones_like(valid), everything, RULES)
    with pytest.raises(BadInput, match="of one render"):
        local_fill(rgb, depth[:-1], valid, component, RULES)
    with pytest.raises(BadInput, match="of one render"):
        local_fill(rgb, depth, valid.astype(np.uint8), component, RULES)  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="in an image of"):
        local_fill(rgb[:50, :50], depth[:50, :50], valid[:50, :50], component, RULES)
    with pytest.raises(Unknown, match="telea"):
        local_fill(rgb, depth, valid, component, RULES, "telea")  # type: ignore[arg-type]


def test_membrane_keeps_the_known_and_stays_in_their_range() -> None:
    rng = np.random.default_rng(0)
    values = rng.uniform(-1, 1, (37, 53, 2)).astype(np.float32)
    known = rng.random((37, 53)) < 0.02
    values[~known] = np.nan
    filled = membrane(values, known)
    np.testing.assert_allclose(filled[known], values[known])
    low, high = values[known].min(axis=0), values[known].max(axis=0)
    assert (filled >= low - 1e-6).all()
    assert (filled <= high + 1e-6).all()
    one = np.zeros((5, 9), bool)
    one[4, 0] = True
    np.testing.assert_allclose(membrane(np.full((5, 9, 1), 3.0, np.float32), one), 3.0)


def test_linear_trend_is_a_plane_or_nothing() -> None:
    y, x = np.mgrid[0:30, 0:40]
    plane = (2.0 + 0.1 * x - 0.05 * y).astype(np.float32)
    known = np.zeros((30, 40), bool)
    known[5:12, 3:20] = True
    np.testing.assert_allclose(linear_trend(np.where(known, plane, np.float32(0)), known), plane, rtol=1e-4)
    noise = np.random.default_rng(0).normal(size=(30, 40)).astype(np.float32)
    assert not linear_trend(noise, known).any()
    assert not linear_trend(np.ones((30, 40), np.float32), known).any()


def test_mirrored_detail_reflects_and_is_zero_for_flat_donors() -> None:
    known = np.zeros((20, 80), bool)
    known[:, :40] = True
    flat = np.full((20, 80, 3), 0.3, np.float32)
    np.testing.assert_allclose(mirrored_detail(flat, known, 20.0, 4.0), 0.0, atol=1e-6)
    stripes = np.random.default_rng(0).random((1, 80, 1)).astype(np.float32) * np.ones((20, 1, 3), np.float32)
    detail = mirrored_detail(stripes, known, 20.0, 4.0)
    np.testing.assert_array_equal(detail[:, 40:59], detail[:, 38:19:-1])
    assert np.abs(detail[:, 40:59]).max() > 0.05
