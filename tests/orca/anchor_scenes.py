"""Random cameras, anchors and decoders that the renderer's tests share."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import ArrayLike

from orca.anchors import FEATURE_DIM, GaussianAnchors, quaternions_to_rotations
from orca.camera import Camera
from orca.conventions import Float64Array
from orca.field.decoders import Decoders

__all__ = ["one_anchor", "random_anchors", "random_camera", "random_decoders", "random_pose"]


def random_pose(seed: int) -> Float64Array:
    """A uniformly rotated, shifted world-to-camera pose, [4, 4]."""
    rng = np.random.default_rng(seed)
    pose = np.eye(4)
    pose[:3, :3] = quaternions_to_rotations(torch.from_numpy(rng.normal(size=(1, 4))))[0].numpy()
    pose[:3, 3] = rng.normal(size=3)
    return pose


def random_camera(seed: int, width: int = 61, height: int = 43) -> Camera:
    """A rotated camera with an off-centre principal point, unequal focal lengths and a little skew."""
    rng = np.random.default_rng(seed + 1000)
    f = width * rng.uniform(0.7, 1.2)
    K = np.array([[f, 0.05 * f, 0.41 * width], [0, 1.15 * f, 0.63 * height], [0, 0, 1]])
    return Camera(K, random_pose(seed), width, height)


def random_anchors(
    seed: int,
    count: int,
    camera: Camera,
    sigma: tuple[float, float] = (0.01, 0.25),
    depth: tuple[float, float] = (0.3, 6.0),
    dtype: torch.dtype = torch.float32,
) -> GaussianAnchors:
    """Anisotropic, freely rotated anchors around what ``camera`` sees: some outside the image, one in ten behind it.

    Standard deviations are log-uniform within ``sigma``, axis by axis.
    """
    rng = np.random.default_rng(seed)
    size = np.array([camera.width, camera.height])
    pixels = rng.uniform(-0.2, 1.2, (count, 2)) * size
    z = rng.uniform(*depth, count)
    z[::10] *= -1
    values = {
        "means": camera.unproject(pixels, z),
        "log_variances": 2 * rng.uniform(np.log(sigma[0]), np.log(sigma[1]), (count, 3)),
        "quaternions": rng.normal(size=(count, 4)),
        "opacity_logits": rng.normal(size=count),
        "features": rng.normal(size=(count, FEATURE_DIM)),
    }
    tensors = {name: torch.from_numpy(value).to(dtype) for name, value in values.items()}
    return GaussianAnchors(**tensors, stage=torch.zeros(count, dtype=torch.uint8))


def one_anchor(mean: ArrayLike, sigma: ArrayLike) -> GaussianAnchors:
    """A single anchor, axes along the world's, of the given standard deviation(s)."""
    log_variances = 2 * np.log(np.broadcast_to(np.asarray(sigma, np.float64), 3))
    return GaussianAnchors(
        torch.tensor(np.asarray(mean, np.float64)[None], dtype=torch.float32),
        torch.tensor(log_variances[None], dtype=torch.float32),
        torch.tensor([[1.0, 0.0, 0.0, 0.0]]),
        torch.full((1,), 2.0),
        torch.ones(1, FEATURE_DIM),
        torch.zeros(1, dtype=torch.uint8),
    )


def random_decoders(seed: int, use_direction: bool = False) -> Decoders:
    """Randomly initialised decoders."""
    return Decoders(use_direction, torch.Generator().manual_seed(seed))
