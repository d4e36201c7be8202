"""Synthetic motions, matches and warped textures with known geometry, for the TSED tests."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from orca.camera import Camera

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

SIZE = 512
FOV = 60.0


def rotation(axis: str, degrees: float) -> Array:
    """Rotation [3, 3] about x (pitch), y (yaw) or z (roll)."""
    vector = np.zeros(3)
    vector["xyz".index(axis)] = np.radians(degrees)
    return np.asarray(cv2.Rodrigues(vector)[0], np.float64)


def pose(R: Array | None = None, t: tuple[float, float, float] | Array = (0.0, 0.0, 0.0)) -> Array:
    """World-to-camera [4, 4]."""
    result = np.eye(4)
    result[:3, :3] = np.eye(3) if R is None else R
    result[:3, 3] = t
    return result


def view(R: Array | None = None, t: tuple[float, float, float] | Array = (0.0, 0.0, 0.0), size: int = SIZE) -> Camera:
    """A square camera of 60 degrees."""
    return Camera.from_fov(size, size, FOV, pose(R, t))


def cloud(seed: int = 0, n: int = 200) -> Array:
    """Points in front of the origin, [n, 3]."""
    rng = np.random.default_rng(seed)
    return rng.uniform([-1.5, -1.5, 4.0], [1.5, 1.5, 8.0], (n, 3))


def matches_of(first: Camera, second: Camera, points: Array | None = None) -> tuple[Array, Array]:
    """Exact matches of two views of a cloud."""
    world = cloud() if points is None else points
    return first.project(world)[0], second.project(world)[0]


@cache
def texture(name: str = "astronaut") -> Image:
    """A photograph that scikit-image ships inside its package."""
    from skimage import data

    return np.ascontiguousarray(getattr(data, name)()[..., :3])


def plane_homography(first: Camera, second: Camera, normal: Array, distance: float) -> Array:
    """H = K2 (R + t n^T / d) K1^-1 of the plane n.X1 = d in the axes of the first camera (X2 = R X1 + t)."""
    relative = second.world_to_camera @ np.linalg.inv(first.world_to_camera)
    R, t = relative[:3, :3], relative[:3, 3]
    return np.asarray(second.K @ (R + np.outer(t, normal) / distance) @ np.linalg.inv(first.K))


def warp(image: Image, H: Array, size: int | None = None) -> Image:
    """Resample an image by a homography given in half-pixel coordinates (Lanczos)."""
    shift = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1.0]])
    target = (size, size) if size else (image.shape[1], image.shape[0])
    return np.asarray(cv2.warpPerspective(image, np.linalg.inv(shift) @ H @ shift, target, flags=cv2.INTER_LANCZOS4))


def camera_of(image: Image, R: Array | None = None, t: tuple[float, float, float] | Array = (0.0, 0.0, 0.0)) -> Camera:
    """A camera of 60 degrees with the size of an image."""
    return Camera.from_fov(image.shape[1], image.shape[0], FOV, pose(R, t))
