"""Pixel centres, number formats, and the one anchor at the one pixel that pins the half-pixel convention down."""

from __future__ import annotations

import numpy as np
import pytest

from orca.anchors import GaussianAnchors
from orca.camera import Camera
from orca.config import RenderConfig
from orca.conventions import pixel_grid, to_float, to_uint8
from orca.render import Renderer, select
from tests.orca.anchor_scenes import one_anchor, random_anchors, random_camera, random_decoders

WIDTH, HEIGHT = 21, 14


def _anchor_at(camera: Camera, pixel: tuple[float, float], sigma_px: float, depth: float = 2.5) -> GaussianAnchors:
    """An anchor whose mean projects to ``pixel`` and whose sigma is ``sigma_px`` pixels there."""
    mean = camera.unproject(np.array([pixel]), np.array([depth]))[0]
    return one_anchor(mean, sigma_px * depth / camera.K[0, 0])


@pytest.mark.parametrize(("column", "row"), [(0, 0), (WIDTH - 1, HEIGHT - 1), (7, 3), (0, 9)])
def test_an_anchor_at_a_pixel_centre_lights_that_pixel_alone(column: int, row: int) -> None:
    """chi2 = 6.25 reaches 2.5 sigma: 0.15 px sigma stays within its pixel, 0.375 px off the centre."""
    camera = Camera.from_fov(WIDTH, HEIGHT, 20)
    anchors = _anchor_at(camera, (column + 0.5, row + 0.5), 0.15)
    hits = select(anchors, camera, RenderConfig())
    alpha = Renderer(anchors, random_decoders(0), RenderConfig()).render(camera).alpha
    assert np.argwhere(hits.count.reshape(HEIGHT, WIDTH)).tolist() == [[row, column]]
    assert hits.m2[0] == pytest.approx(0, abs=1e-6)
    assert np.argwhere(alpha > 0).tolist() == [[row, column]]


def test_the_peak_is_at_that_pixel_and_falls_off_evenly() -> None:
    camera = Camera.from_fov(WIDTH, HEIGHT, 10)
    anchors = _anchor_at(camera, (10.5, 6.5), 1.0)
    alpha = Renderer(anchors, random_decoders(0), RenderConfig()).render(camera).alpha
    assert np.unravel_index(alpha.argmax(), alpha.shape) == (6, 10)
    around = [alpha[6, 9], alpha[6, 11], alpha[5, 10], alpha[7, 10]]
    assert np.ptp(around) < 1e-3 * alpha[6, 10]
    assert max(around) < 0.7 * alpha[6, 10]


def test_an_anchor_at_a_pixel_corner_lights_the_four_around_it_or_none() -> None:
    camera = Camera.from_fov(WIDTH, HEIGHT, 10)
    small = select(_anchor_at(camera, (10.0, 6.0), 0.2), camera, RenderConfig())  # 0.5 px < sqrt(1/2)
    large = select(_anchor_at(camera, (10.0, 6.0), 0.35), camera, RenderConfig())  # 0.875 px
    assert small.count.sum() == 0
    assert np.argwhere(large.count.reshape(HEIGHT, WIDTH)).tolist() == [[5, 9], [5, 10], [6, 9], [6, 10]]


def test_pixel_grid_is_row_major_with_centres_at_a_half() -> None:
    assert pixel_grid(3, 2).tolist() == [[0.5, 0.5], [1.5, 0.5], [2.5, 0.5], [0.5, 1.5], [1.5, 1.5], [2.5, 1.5]]


def test_a_crop_renders_the_same_pixels_as_the_full_view() -> None:
    camera = random_camera(3)
    renderer = Renderer(random_anchors(3, 200, camera), random_decoders(3, use_direction=True), RenderConfig())
    left, top, right, bottom = 13, 6, 20, 11
    crop = camera.padded(-left, -top, -right, -bottom)
    full, part = renderer.render(camera), renderer.render(crop)
    assert (crop.width, crop.height) == (camera.width - 33, camera.height - 17)
    assert part.alpha.max() > 0.4
    window = np.s_[top : camera.height - bottom, left : camera.width - right]
    for name in ("rgb", "alpha", "depth"):
        np.testing.assert_allclose(getattr(part, name), getattr(full, name)[window], rtol=2e-6, atol=1e-6)
    counts = renderer.hits(camera).count.reshape(full.alpha.shape)
    np.testing.assert_array_equal(renderer.hits(crop).count.reshape(part.alpha.shape), counts[window])


def test_a_resized_camera_sees_the_same_rays() -> None:
    camera = random_camera(4)
    double = camera.resized(2 * camera.width, 3 * camera.height)
    points = np.array([[0.0, 0.0], [camera.width, camera.height], [3.5, 8.5]])
    np.testing.assert_allclose(double.rays(points * [2, 3]), camera.rays(points), rtol=1e-12)
    middle = pixel_grid(double.width, double.height).reshape(double.height, double.width, 2)[1::3]
    mean_of_two = (middle[:, 0::2] + middle[:, 1::2]) / 2  # of two pixels side by side, in the middle one of three rows
    np.testing.assert_allclose(mean_of_two.reshape(-1, 2) / [2, 3], pixel_grid(camera.width, camera.height))


def test_to_uint8_clips_rounds_and_blackens_nan() -> None:
    given = np.array([-0.1, 0.0, 0.49 / 255, 0.5 / 255, 1.49 / 255, 254.6 / 255, 1.0, 1.7, np.nan, np.inf, -np.inf])
    assert to_uint8(given).tolist() == [0, 0, 0, 1, 1, 255, 255, 255, 0, 255, 0]
    assert to_uint8(given).dtype == np.uint8


def test_bytes_survive_the_round_trip() -> None:
    every = np.arange(256, dtype=np.uint8)
    assert to_float(every).dtype == np.float32
    np.testing.assert_array_equal(to_uint8(to_float(every)), every)
