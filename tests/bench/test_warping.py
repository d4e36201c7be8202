"""Forward warping: hand-worked shifts, the z-buffer, a slow reference, and what counts as surely visible."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from bench.warping import Splat, forward_splat, project_depth, sure_points
from orca.camera import Camera
from orca.conventions import pixel_grid
from orca.errors import BadInput
from tests.bench.small_cases import camera_of, noise_image, plane, shifted_pose

H, W = 20, 32


def slow_splat(image: NDArray[np.uint8], depth: NDArray[np.float32], source: Camera, target: Camera) -> Splat:
    """One point at a time, in order; a later point must be strictly nearer to win."""
    rgb = np.zeros((target.height, target.width, 3), np.uint8)
    nearest = np.full((target.height, target.width), np.inf)
    winner = np.full((target.height, target.width), -1, np.int64)
    positions, z = target.project(source.unproject(pixel_grid(source.width, source.height), depth.ravel()))
    for i, ((x, y), near) in enumerate(zip(positions, z, strict=True)):
        if near <= 0 or not (0 <= x < target.width and 0 <= y < target.height):
            continue
        row, column = int(y), int(x)
        if near < nearest[row, column]:
            nearest[row, column], winner[row, column] = near, i
            rgb[row, column] = image.reshape(-1, 3)[i]
    return Splat(rgb, nearest.astype(np.float32), winner >= 0, winner)


def test_the_same_camera_gives_the_same_image() -> None:
    image, camera = noise_image(H, W), camera_of(H, W)
    depth = np.random.default_rng(1).uniform(0.5, 5, (H, W)).astype(np.float32)
    splat = forward_splat(image, depth, camera, camera)
    np.testing.assert_array_equal(splat.rgb, image)
    np.testing.assert_array_equal(splat.source.ravel(), np.arange(H * W))
    np.testing.assert_allclose(splat.depth, depth, rtol=1e-6)


def test_a_plane_moves_by_f_b_over_z() -> None:
    """A camera 3 z / f to the right sees the plane 3 px further left, and nothing in its 3 last columns."""
    image, camera = noise_image(H, W), camera_of(H, W)
    target = camera_of(H, W, shifted_pose(x=3 * 2.0 / camera.K[0, 0]))
    splat = forward_splat(image, plane(H, W, 2.0), camera, target)
    np.testing.assert_array_equal(splat.rgb[:, :-3], image[:, 3:])
    assert not splat.hit[:, -3:].any()
    assert (splat.rgb[:, -3:] == 0).all()
    assert np.isinf(splat.depth[:, -3:]).all()
    assert (splat.source[:, -3:] == -1).all()


def test_the_nearer_point_wins() -> None:
    """A near column that moves 4 px lands on a far one that moves 2 px: the near colour is seen."""
    image, camera = noise_image(H, W), camera_of(H, W)
    depth = plane(H, W, 4.0)
    depth[:, 20] = 2.0
    target = camera_of(H, W, shifted_pose(x=2 * 4.0 / camera.K[0, 0]))
    splat = forward_splat(image, depth, camera, target)
    np.testing.assert_array_equal(splat.rgb[:, 16], image[:, 20])  # where column 18 of the far plane lands too
    assert not splat.hit[:, 18].any()  # the far plane behind column 20 was never seen


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_equals_the_slow_reference(seed: int) -> None:
    rng = np.random.default_rng(seed)
    image = noise_image(9, 13, seed)
    depth = rng.choice([0.5, 1.0, 2.0], (9, 13)).astype(np.float32)  # many equal depths: ties are tested
    angle = rng.uniform(-0.3, 0.3)
    pose = shifted_pose(*rng.uniform(-0.4, 0.4, 3))
    pose[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    source = Camera(camera_of(9, 13).K, shifted_pose(*rng.uniform(-0.1, 0.1, 3)), 13, 9)
    target = Camera.from_fov(17, 11, 70.0, pose)
    fast, slow = forward_splat(image, depth, source, target), slow_splat(image, depth, source, target)
    np.testing.assert_array_equal(fast.hit, slow.hit)
    np.testing.assert_array_equal(fast.rgb, slow.rgb)
    np.testing.assert_allclose(fast.depth, slow.depth, rtol=1e-6)


def test_positions_equal_unproject_and_project() -> None:
    rng = np.random.default_rng(3)
    depth = rng.uniform(1, 4, (H, W)).astype(np.float32)
    source, target = camera_of(H, W, shifted_pose(0.2)), camera_of(H, W, shifted_pose(-0.1, 0.3, 0.2))
    pixels, z = target.project(source.unproject(pixel_grid(W, H), depth.ravel()))
    projection = project_depth(depth, source, target)
    np.testing.assert_allclose(projection.pixels, pixels, atol=1e-9)
    np.testing.assert_allclose(projection.z, z, atol=1e-12)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("broken", [np.nan, np.inf, 0.0, -1.0])
def test_points_without_depth_are_dropped(broken: float) -> None:
    depth = plane(H, W)
    depth[4, 5] = broken
    camera = camera_of(H, W)
    splat = forward_splat(noise_image(H, W), depth, camera, camera)
    assert not splat.hit[4, 5]
    assert splat.hit.sum() == H * W - 1
    sure, _ = sure_points(depth, camera, camera)
    assert not sure.reshape(H, W)[3:6, 4:7].any()
    assert sure.reshape(H, W)[10, 10]


def test_points_behind_the_camera_are_dropped() -> None:
    camera = camera_of(H, W)
    splat = forward_splat(noise_image(H, W), plane(H, W, 2.0), camera, camera_of(H, W, shifted_pose(z=3.0)))
    assert not splat.hit.any()


def test_sure_points_leave_out_what_is_hidden() -> None:
    """A near square covers part of a far plane after the move; exactly known which far pixels it covers."""
    height, width = 60, 80
    camera = camera_of(height, width)
    depth = plane(height, width, 4.0)
    depth[20:40, 40:60] = 2.0
    target = camera_of(height, width, shifted_pose(x=8 * 4.0 / camera.K[0, 0]))  # far moves 8 px, near 16 px
    sure = sure_points(depth, camera, target)[0].reshape(height, width)
    # The square lands on columns 24..43, which the far plane's columns 32..51 reach: 32..39 are seen far pixels.
    assert not sure[20:40, 32:40].any()
    assert sure[22:38, 42:58].all()  # the square itself, its depth edge left out
    assert sure[22:38, 12:26].all()  # far plane away from it
    assert not sure[:, :8].any()  # left the frame


def test_sure_points_close_the_cracks_of_a_magnified_foreground() -> None:
    """A camera close to a near plane opens cracks in it; the far plane behind must not count as seen through them."""
    height, width = 64, 64
    camera = camera_of(height, width)
    depth = plane(height, width, 3.0)
    depth[8:56, 8:40] = 1.0
    target = camera_of(height, width, shifted_pose(x=0.25, z=0.5))  # magnified twice
    splat = forward_splat(noise_image(height, width), depth, camera, target)
    far = (depth.ravel() == 3.0) & (splat.source.ravel()[:, None] == np.arange(depth.size)).any(axis=0)
    sure, projection = sure_points(depth, camera, target)
    near_area = forward_splat(noise_image(height, width), np.where(depth == 1.0, depth, np.nan), camera, target).hit
    rows, columns = np.nonzero(near_area)
    inner = np.zeros((height, width), np.bool_)
    inner[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1] = True
    leaking = far & (projection.index >= 0) & inner.ravel()[np.maximum(projection.index, 0)]
    assert leaking.sum() > 20
    one_pixel = sure_points(depth, camera, target, window=1)[0]
    assert (one_pixel & leaking).sum() > 20  # without the window they would count
    assert not (sure & leaking).any()


def test_wrong_sizes_are_refused() -> None:
    camera = camera_of(H, W)
    with pytest.raises(BadInput, match="depth of shape"):
        forward_splat(noise_image(H, W), plane(H, W + 1), camera, camera)
    with pytest.raises(BadInput, match="image of shape"):
        forward_splat(noise_image(H + 1, W), plane(H, W), camera, camera)
