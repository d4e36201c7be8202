"""Tiny scene cases for the tests of warping and of the metrics."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bench.datasets.case import SceneCase, TrueView
from bench.trajectories.trajectory import Trajectory
from orca.camera import Camera


def noise_image(height: int, width: int, seed: int = 0) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


def smooth_image(height: int, width: int) -> NDArray[np.uint8]:
    """Slow waves in three colours."""
    y, x = np.mgrid[0:height, 0:width]
    waves = [np.sin(x / 7 + k) * np.cos(y / 9 - k) for k in range(3)]
    return np.asarray(127.5 + 100 * np.stack(waves, axis=2), np.float64).round().astype(np.uint8)


def shifted_pose(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> NDArray[np.float64]:
    """World-to-camera pose of a camera that stands at (x, y, z)."""
    pose = np.eye(4)
    pose[:3, 3] = -x, -y, -z
    return pose


def camera_of(height: int, width: int, pose: NDArray[np.float64] | None = None) -> Camera:
    return Camera.from_fov(width, height, 60.0, pose)


def make_case(
    image: NDArray[np.uint8],
    depth: NDArray[np.float32],
    poses: Sequence[NDArray[np.float64]],
    true_views: tuple[TrueView, ...] = (),
) -> SceneCase:
    height, width = image.shape[:2]
    camera = camera_of(height, width)
    trajectory = Trajectory("test", camera.K, np.stack(poses), width, height)
    every = tuple(range(len(poses)))
    return SceneCase(
        "test", "scene", image, camera, depth, "exact", True, "exact", trajectory, every, true_views=true_views
    )


def plane(height: int, width: int, depth: float = 2.0) -> NDArray[np.float32]:
    return np.full((height, width), depth, np.float32)
