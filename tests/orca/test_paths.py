"""Camera paths: geometry that must hold, the published poses, and typed errors."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orca import paths
from orca.camera import Camera
from orca.camera_file import read_camera_document, read_cameras
from orca.errors import BadInput, Unknown

CLOSED = ["vistadream", "spiral", "orbit", "swing", "dolly"]


def centers(poses: np.ndarray) -> np.ndarray:
    return -np.einsum("fji,fj->fi", poses[:, :3, :3], poses[:, :3, 3])


@pytest.mark.parametrize("name", paths.PATHS)
@settings(max_examples=15, deadline=None)
@given(frames=st.integers(2, 120), radius=st.floats(0.01, 50))
def test_every_path_starts_at_the_input_and_is_rigid(name: str, frames: int, radius: float) -> None:
    poses = paths.make_path(name, frames, radius)
    assert poses.shape == (frames, 4, 4)
    assert poses.dtype == np.float64
    np.testing.assert_allclose(poses[0], np.eye(4), atol=1e-12 * max(1.0, radius))
    rotation = poses[:, :3, :3]
    np.testing.assert_allclose(rotation @ rotation.transpose(0, 2, 1), np.tile(np.eye(3), (frames, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(rotation), 1.0, atol=1e-12)
    np.testing.assert_array_equal(poses[:, 3], np.tile([0.0, 0.0, 0.0, 1.0], (frames, 1)))
    if name in CLOSED:
        np.testing.assert_allclose(poses[-1], np.eye(4), atol=1e-12 * max(1.0, radius))


@pytest.mark.parametrize("name", paths.PATHS)
def test_the_radius_scales_positions_and_turns_nothing(name: str) -> None:
    one, three = paths.make_path(name, 31), paths.make_path(name, 31, 3.0)
    np.testing.assert_allclose(three[:, :3, :3], one[:, :3, :3], atol=1e-12)
    np.testing.assert_allclose(three[:, :3, 3], 3.0 * one[:, :3, 3], atol=1e-12)


def test_stated_extents() -> None:
    assert np.abs(centers(paths.swing(401, extent=0.2))).max(axis=0) == pytest.approx([0.2, 0.2 / 3, 0.0], abs=1e-4)
    z = centers(paths.dolly(401, extent=0.3))[:, 2]
    assert (z.max(), z.min()) == pytest.approx((0.3, -0.3), abs=1e-9)
    assert centers(paths.forward(11, radius=2.0, extent=0.3))[-1] == pytest.approx([0, 0, 0.6])
    assert centers(paths.back(11, extent=0.3))[-1] == pytest.approx([0, 0, -0.3])
    radii = np.linalg.norm(centers(paths.orbit(101, radius=2.0, look_at=1.5)) - [0, 0, 3.0], axis=1)
    np.testing.assert_allclose(radii, 3.0, atol=1e-12)
    side, up, deep = np.abs(centers(paths.spiral(401, extent=0.15))).max(axis=0)
    assert side == pytest.approx(0.15)
    assert 0.06 < up <= 0.075
    assert 0.05 < deep <= 0.075


def test_orbit_turns_by_the_stated_angle_and_first_to_the_right() -> None:
    poses = paths.orbit(401, angle_deg=15)
    angle = np.degrees(np.arccos(np.clip((np.trace(poses[:, :3, :3], axis1=1, axis2=2) - 1) / 2, -1, 1)))
    assert angle.max() == pytest.approx(15, abs=1e-3)
    assert centers(poses)[50, 0] > 0


@pytest.mark.parametrize("path", [paths.spiral, paths.swing, paths.orbit])
def test_the_fixation_point_stays_on_the_optical_axis(path: paths.CameraPath) -> None:
    target = np.array([0.0, 0.0, 1.0, 1.0])
    local = path(50) @ target  # type: ignore[operator]
    np.testing.assert_allclose(local[:, :2], 0.0, atol=1e-12)
    assert (local[:, 2] > 0).all()


def test_vistadream_by_hand() -> None:
    """Five frames, t = 0, 1/4, ... backwards: frame 3 is i = 1, r = 0.3, theta = 2 pi * 5/4, z = -0.3 * 0.2."""
    pose = paths.vistadream(5, 1.0, forward_ratio=0.2, backward_ratio=0.8)[3]
    np.testing.assert_allclose(pose[:3, 3], [0.0, 0.3 * 0.3, -0.06], atol=1e-12)
    ahead = np.array([0.0, -0.09, 0.56]) / np.hypot(0.09, 0.56)
    np.testing.assert_allclose(pose[:3, 2], ahead, atol=1e-12)
    np.testing.assert_allclose(pose[:3, 0], [1.0, 0.0, 0.0], atol=1e-12)
    backwards = paths.vistadream(5, 1.0, forward_ratio=0.2, backward_ratio=0.8)[1]  # i = 3, r = -0.3
    assert backwards[2, 3] == pytest.approx(0.3 * 0.8)


def test_vistadream_is_the_published_path(data_root: Path) -> None:
    files = sorted((data_root / "vistadream" / "cameras").glob("*.json"))
    assert len(files) == 11
    for file in files:
        document = json.loads(file.read_text())
        spiral = document["spiral"]
        ours = paths.vistadream(
            len(document["world_to_camera"]), spiral["radius"], spiral["forward_ratio"], spiral["backward_ratio"]
        )
        published = np.asarray(document["world_to_camera"]).reshape(-1, 4, 4)
        assert np.abs(ours - published).max() < 1e-6, file.stem


def test_scene_radius_by_hand() -> None:
    """A plane at z = 2 seen with f = 100: x of the 100 pixel centres spans 1.98, 5..95 is 1.782 of it; z has none."""
    camera = Camera(np.array([[100.0, 0, 50], [0, 100.0, 50], [0, 0, 1]]), np.eye(4), 100, 100)
    depth = np.full((100, 100), 2.0, np.float32)
    assert paths.scene_radius(depth, camera) == pytest.approx((1.782 + 1.782 + 0.0) / 3)


def test_scene_radius_scales_with_depth_and_ignores_the_pose() -> None:
    depth = np.random.default_rng(0).uniform(1, 3, (20, 30)).astype(np.float32)
    camera = Camera.from_fov(30, 20, 60)
    moved = Camera.from_fov(30, 20, 60, paths.orbit(5)[1])
    radius = paths.scene_radius(depth, camera)
    assert paths.scene_radius(depth * 4, camera) == pytest.approx(4 * radius)
    assert paths.scene_radius(depth, moved) == pytest.approx(radius)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 0.0, -1.0])
def test_scene_radius_refuses_bad_depth(bad: float) -> None:
    depth = np.ones((20, 30), np.float32)
    depth[3, 4] = bad
    with pytest.raises(BadInput):
        paths.scene_radius(depth, Camera.from_fov(30, 20, 60))


def test_scene_radius_refuses_another_size_and_a_single_pixel() -> None:
    with pytest.raises(BadInput):
        paths.scene_radius(np.ones((30, 20), np.float32), Camera.from_fov(30, 20, 60))
    with pytest.raises(BadInput, match="no extent"):
        paths.scene_radius(np.ones((1, 1), np.float32), Camera.from_fov(1, 1, 60))


def test_typed_errors() -> None:
    with pytest.raises(Unknown, match="did you mean 'spiral'"):
        paths.make_path("spirall")
    with pytest.raises(BadInput):
        paths.make_path("swing", frames=1)
    with pytest.raises(BadInput):
        paths.orbit(10, angle_deg=180)


def test_default_lengths() -> None:
    assert {name: len(paths.make_path(name)) for name in paths.PATHS} == {
        name: path.frames for name, path in paths.PATHS.items()
    }
    assert paths.PATHS["vistadream"].frames == 250


def test_path_cameras_keep_the_intrinsics() -> None:
    camera = Camera.from_fov(64, 48, 60)
    cameras = paths.path_cameras(paths.swing(7), camera)
    assert len(cameras) == 7
    assert all((c.K == camera.K).all() and (c.width, c.height) == (64, 48) for c in cameras)


def test_read_cameras_of_the_published_form(data_root: Path) -> None:
    cameras = read_cameras(data_root / "vistadream" / "cameras" / "bust.json")
    assert len(cameras) == 250
    assert cameras[0].K[0, 0] == pytest.approx(495.1184, abs=1e-3)
    assert (cameras[0].width, cameras[0].height) == (512, 512)


def write(path: Path, document: object) -> Path:
    path.write_text(json.dumps(document))
    return path


GOOD = {
    "name": "x",
    "width": 4,
    "height": 3,
    "K": [[5, 0, 2], [0, 5, 1.5], [0, 0, 1]],
    "world_to_camera": [np.eye(4).tolist()] * 2,
}


def test_read_cameras_of_the_plain_form(tmp_path: Path) -> None:
    cameras = read_cameras(write(tmp_path / "a.json", GOOD))
    assert len(cameras) == 2
    assert cameras[1].K[0, 2] == 2


@pytest.mark.parametrize(
    "change",
    [
        {"K": [[1, 2], [3, 4]]},
        {"K": [[[5, 0, 2], [0, 5, 1.5], [0, 0, 1]]]},
        {"world_to_camera": []},
        {"world_to_camera": [[1, 2], [3]]},
        {"width": "wide"},
        {"width": 0},
    ],
)
def test_read_cameras_refuses_broken_fields(tmp_path: Path, change: dict[str, object]) -> None:
    with pytest.raises(BadInput):
        read_cameras(write(tmp_path / "a.json", GOOD | change))


def test_read_camera_document_refuses_what_is_no_camera_file(tmp_path: Path) -> None:
    (tmp_path / "text.json").write_text("no json")
    for path in (tmp_path / "none.json", tmp_path / "text.json", tmp_path, write(tmp_path / "list.json", [1])):
        with pytest.raises(BadInput):
            read_camera_document(path)
    with pytest.raises(BadInput, match="height"):
        read_camera_document(write(tmp_path / "b.json", {k: v for k, v in GOOD.items() if k != "height"}))
    with pytest.raises(BadInput):
        read_camera_document(write(tmp_path / "c.json", {"K_512": 1}))
