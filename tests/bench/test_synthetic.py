"""Synthetic scenes: exact depth, exact visibility, and textures that do not depend on who looks."""

from __future__ import annotations

import numpy as np
import pytest

from bench.datasets import open_dataset
from bench.datasets.case import SceneCase
from bench.datasets.synthetic import SEEDS, Synthetic
from bench.datasets.synthetic_scene import Box, Plane, hidden_from, random_scene, render_colour, render_depth
from bench.datasets.synthetic_textures import PREDICTABLE, UNPREDICTABLE, random_texture
from orca.camera import Camera
from orca.errors import BadInput, Unknown

SIZE = 64
NEAR, FAR = 1.0, 2.0


@pytest.fixture(scope="module")
def case() -> SceneCase:
    return Synthetic(size=96).load("predictable-03")


def square_before_a_wall() -> tuple[Plane, Box]:
    """A wall at depth 2 and a plate of side 0.4 at depth 1, seen straight on."""
    texture = random_texture("stripes", np.random.default_rng(0))
    wall = Plane(np.array([0.0, 0.0, 1.0]), FAR, np.eye(3)[:2], texture)
    plate = Box(np.array([0.0, 0.0, NEAR + 1e-4]), np.array([0.2, 0.2, 1e-4]), np.eye(3), texture)
    return wall, plate


def moved_right(step: float) -> Camera:
    pose = np.eye(4)
    pose[0, 3] = -step
    return Camera.from_fov(SIZE, SIZE, 90, pose)


def test_depth_and_hidden_strip_by_hand() -> None:
    # f = 32 px. The plate spans columns 32 +- 6.4 of the input; seen from 0.5 to the right it shifts by 16 px and the
    # wall by 8, so what it hid is shifted by 8 and lies right of it: columns 16 + 6.4 ... and on to 24 + 6.4.
    scene = square_before_a_wall()
    source, view = Camera.from_fov(SIZE, SIZE, 90), moved_right(0.5)
    depth = render_depth(scene, source)
    assert depth[32, 26] == pytest.approx(NEAR, abs=1e-5)
    assert depth[32, 24] == pytest.approx(FAR, abs=1e-5)
    hidden = hidden_from(scene, source, view)
    row = hidden.occluded[32]
    # On the wall the plate's shadow reaches from -0.4 to 0.4: columns 24 +- 6.4, of which the plate (16 +- 6.4)
    # covers what lies left of 22.4.
    assert np.flatnonzero(row).tolist() == list(range(22, 30))
    assert hidden.occluder_depth[32, 25] == pytest.approx(NEAR, abs=1e-5)
    assert np.isnan(hidden.occluder_depth[32, 5])
    assert not hidden.outside[32, :40].any()
    assert hidden.outside[32, 57:].all()  # the wall shifts left by 8 px: eight columns come in from outside


def test_the_source_hides_nothing_from_itself() -> None:
    source = Camera.from_fov(SIZE, SIZE, 60)
    hidden = hidden_from(random_scene(5, PREDICTABLE), source, source)
    assert not hidden.occluded.any()
    assert not hidden.outside.any()


def test_a_side_that_hid_itself_has_no_occluder() -> None:
    texture = random_texture("gradient", np.random.default_rng(0))
    wall = Plane(np.array([0.0, 0.0, 1.0]), 3.0, np.eye(3)[:2], texture)
    cube = Box(np.array([0.0, 0.0, 1.5]), np.array([0.3, 0.3, 0.3]), np.eye(3), texture)
    hidden = hidden_from((wall, cube), Camera.from_fov(SIZE, SIZE, 90), moved_right(0.8))
    side = hidden.occluded & np.isnan(hidden.occluder_depth)
    assert side.sum() > 20
    assert (hidden.occluded & np.isfinite(hidden.occluder_depth)).sum() > 20


def test_scenes_are_named_and_repeat() -> None:
    dataset = open_dataset("synthetic")
    names = dataset.scenes()
    assert len(names) == 2 * SEEDS == 40
    assert names[0] == "predictable-00"
    assert names[-1] == "unpredictable-19"
    small = Synthetic(size=32)
    first, again = small.load("unpredictable-02"), small.load("unpredictable-02")
    np.testing.assert_array_equal(first.image, again.image)
    np.testing.assert_array_equal(first.depth, again.depth)


def test_the_two_kinds_share_their_geometry() -> None:
    small = Synthetic(size=32)
    one, two = small.load("predictable-06"), small.load("unpredictable-06")
    np.testing.assert_array_equal(one.depth, two.depth)
    assert np.abs(one.image.astype(int) - two.image).mean() > 2
    for a, b in zip(one.true_views, two.true_views, strict=True):
        np.testing.assert_array_equal(a.hidden, b.hidden)


def test_what_is_not_hidden_is_where_the_input_says(case: SceneCase) -> None:
    smooth = np.abs(np.diff(case.depth, axis=1, append=case.depth[:, -1:])) < 0.005
    for view in case.true_views:
        assert view.depth is not None
        y, x = np.nonzero(~view.hidden)
        points = view.camera.unproject(np.stack([x + 0.5, y + 0.5], 1), view.depth[y, x])
        pixels, z = case.camera.project(points)
        inside = ((pixels >= 1) & (pixels <= case.camera.width - 1)).all(1)
        u, v = np.floor(pixels[inside]).astype(int).T
        ratio = z[inside] / case.depth[v, u]
        assert np.quantile(np.abs(ratio[smooth[v, u]] - 1), 0.95) < 0.03


def test_an_occluder_is_nearer_in_the_input_and_known_where_another_object_hides(case: SceneCase) -> None:
    for view in case.true_views:
        assert view.occluder_depth is not None
        known = np.isfinite(view.occluder_depth)
        assert (view.hidden | ~known).all()
        assert 0.01 < view.hidden.mean() < 0.3
        assert (view.occluder_depth[known] > 0).all()


@pytest.mark.parametrize("kind", [*PREDICTABLE, *UNPREDICTABLE])
def test_textures_are_colours_and_vary(kind: str) -> None:
    texture = random_texture(kind, np.random.default_rng(3))
    u, v = np.random.default_rng(0).uniform(-3, 3, (2, 500))
    colours = texture.colours(u, v)
    assert colours.shape == (500, 3)
    assert colours.min() >= 0
    assert colours.max() <= 1
    assert colours.std(0).max() > 0.01
    np.testing.assert_array_equal(colours, texture.colours(u, v))


def test_supersampling_agrees_with_casting_every_ray() -> None:
    scene, camera = random_scene(1, UNPREDICTABLE), Camera.from_fov(48, 48, 60)
    fine = render_colour(scene, camera.resized(96, 96), samples=1).astype(np.float64)
    mean = fine.reshape(48, 2, 48, 2, 3).mean((1, 3))
    assert np.abs(render_colour(scene, camera, samples=2) - mean).max() <= 1.0


def test_unseen_scenes_are_other_scenes_of_the_same_kind() -> None:
    unseen = open_dataset("synthetic-unseen")
    assert unseen.scenes()[0] == "predictable-100"
    assert len(unseen.scenes()) == len(Synthetic().scenes())
    assert not set(unseen.scenes()) & set(Synthetic().scenes())
    assert unseen.load("predictable-103").dataset == "synthetic-unseen"


def test_bad_requests() -> None:
    with pytest.raises(Unknown, match="predictable-04"):
        Synthetic().load("predictable-4")
    with pytest.raises(BadInput, match="at least 16"):
        Synthetic(size=8)
    with pytest.raises(Unknown, match="swing"):
        open_dataset("synthetic", trajectory="swingg").load("predictable-00")
