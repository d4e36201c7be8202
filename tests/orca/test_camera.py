"""The pinhole camera: projection and its inverse, views of other sizes, rejected input."""

from __future__ import annotations

import numpy as np
import pytest

from orca.camera import Camera
from orca.errors import BadInput
from tests.orca.anchor_scenes import random_camera, random_pose

EYE = np.eye(4)
K = np.array([[100.0, 0, 50], [0, 100, 40], [0, 0, 1]])


@pytest.mark.parametrize("seed", range(4))
def test_unprojecting_what_was_projected_gives_the_points_back(seed: int) -> None:
    camera = random_camera(seed)
    rng = np.random.default_rng(seed)
    pixels, depth = rng.uniform(-20, 90, (50, 2)), rng.uniform(0.1, 20, 50)
    points = camera.unproject(pixels, depth)
    again, z = camera.project(points)
    np.testing.assert_allclose(again, pixels, atol=1e-9)
    np.testing.assert_allclose(z, depth, rtol=1e-12)


def test_projection_worked_by_hand() -> None:
    pixels, z = Camera(K, EYE, 100, 80).project(np.array([[1.0, -0.5, 2.0], [0.0, 0.0, 4.0]]))
    np.testing.assert_allclose(pixels, [[100, 15], [50, 40]])
    assert z.tolist() == [2.0, 4.0]


def test_a_shifted_camera_sees_the_world_shift_the_other_way() -> None:
    pose = EYE.copy()
    pose[0, 3] = -0.5  # the camera moved 0.5 to the right
    camera = Camera(K, pose, 100, 80)
    assert camera.center.tolist() == [0.5, 0, 0]
    np.testing.assert_allclose(camera.project(np.array([[0.5, 0, 1.0]]))[0], [[50, 40]])


def test_points_behind_the_camera_have_negative_depth() -> None:
    assert Camera(K, EYE, 100, 80).project(np.array([[0.0, 0, -1], [0, 0, 0]]))[1].tolist() == [-1, 0]


def test_rays_have_unit_depth_in_camera_axes_and_hit_their_pixel() -> None:
    camera = random_camera(2, 9, 7)
    rays = camera.rays()
    local = rays @ camera.rotation.T
    np.testing.assert_allclose(local[:, 2], 1)
    pixels, _ = camera.project(camera.center + 3 * rays)
    np.testing.assert_allclose(pixels[9 * 2 + 4], [4.5, 2.5], atol=1e-9)
    assert rays.shape == (63, 3)


@pytest.mark.parametrize("hfov", [20.0, 60.0, 120.0])
def test_field_of_view_is_what_was_asked_for(hfov: float) -> None:
    camera = Camera.from_fov(320, 200, hfov, random_pose(1))
    assert camera.hfov_deg == pytest.approx(hfov)
    left, right = camera.rays(np.array([[0.0, 100.0], [320.0, 100.0]]))
    angle = np.degrees(np.arccos(left @ right / np.linalg.norm(left) / np.linalg.norm(right)))
    assert angle == pytest.approx(hfov)
    assert camera.K[0, 0] == camera.K[1, 1]


def test_off_centre_field_of_view_adds_both_sides() -> None:
    camera = Camera.from_fov(100, 100, 90)  # f = 50: 45 degrees to either side
    wider = camera.padded(0, 0, 36, 0)
    assert wider.hfov_deg == pytest.approx(45 + np.degrees(np.arctan2(86, 50)))


def test_padding_keeps_the_rays_and_can_be_undone() -> None:
    camera = random_camera(5)
    padded = camera.padded(4, 7, 11, 2)
    assert (padded.width, padded.height) == (camera.width + 15, camera.height + 9)
    np.testing.assert_allclose(padded.rays(np.array([[4.5, 7.5]])), camera.rays(np.array([[0.5, 0.5]])))
    np.testing.assert_allclose(padded.padded(-4, -7, -11, -2).K, camera.K, rtol=1e-15)


def test_resizing_there_and_back() -> None:
    camera = random_camera(6)
    np.testing.assert_allclose(camera.resized(128, 96).resized(camera.width, camera.height).K, camera.K)
    assert camera.resized(128, 96).hfov_deg == pytest.approx(camera.hfov_deg)


def test_a_camera_keeps_its_own_read_only_arrays() -> None:
    mine = K.copy()
    camera = Camera(mine, EYE, 100, 80)
    mine[0, 0] = 5
    assert camera.K[0, 0] == 100
    with pytest.raises(ValueError, match="read-only"):
        camera.K[0, 0] = 5
    with pytest.raises(ValueError, match="read-only"):
        camera.world_to_camera[0, 3] = 1


def _with(matrix: np.ndarray, index: tuple[int, int], value: float) -> np.ndarray:
    out = matrix.copy()
    out[index] = value
    return out


@pytest.mark.parametrize(
    ("intrinsics", "pose", "width", "height"),
    [
        (K[:2], EYE, 100, 80),
        (K, EYE[:3], 100, 80),
        (_with(K, (0, 2), np.nan), EYE, 100, 80),
        (K, _with(EYE, (0, 3), np.inf), 100, 80),
        (K, EYE, 0, 80),
        (K, EYE, 100, -1),
        (_with(K, (0, 0), 0.0), EYE, 100, 80),
        (_with(K, (1, 1), -3.0), EYE, 100, 80),
    ],
)
def test_broken_cameras_are_rejected(intrinsics: np.ndarray, pose: np.ndarray, width: int, height: int) -> None:
    with pytest.raises(BadInput, match="check the camera file"):
        Camera(intrinsics, pose, width, height)


@pytest.mark.parametrize("hfov", [0.0, -60.0, 180.0, float("nan")])
def test_impossible_fields_of_view_are_rejected(hfov: float) -> None:
    with pytest.raises(BadInput, match="1 to 170 degrees"):
        Camera.from_fov(10, 10, hfov)


def test_cropping_everything_away_is_rejected() -> None:
    with pytest.raises(BadInput, match="positive size"):
        Camera(K, EYE, 100, 80).padded(-60, 0, -40, 0)
