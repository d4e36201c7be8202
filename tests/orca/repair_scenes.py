"""A small scene with something to repair: a near square in front of a far, textured wall."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from orca.camera import Camera
from orca.config import ReconstructConfig, get_preset
from orca.conventions import Float32Array
from orca.priors.depth import DepthEstimate

NEAR, FAR = 1.0, 2.0
SIZE = 64


def picture() -> tuple[Float32Array, Float32Array]:
    """Image [64, 64, 3] and depth: a red square at depth 1 on a green-blue gradient at depth 2."""
    y, x = np.mgrid[0:SIZE, 0:SIZE] / SIZE
    image = np.stack([0.1 + 0 * x, 0.3 + 0.5 * x, 0.3 + 0.5 * y], 2)
    depth = np.full((SIZE, SIZE), FAR)
    square = slice(20, 44)
    image[square, square] = [0.9, 0.15, 0.1]
    depth[square, square] = NEAR
    return image.astype(np.float32), depth.astype(np.float32)


def input_camera() -> Camera:
    """The input view, 60 degrees wide."""
    return Camera.from_fov(SIZE, SIZE, 60)


def sideways(step: float, frames: int = 3) -> tuple[Camera, ...]:
    """Views that move to the right by ``step`` each, looking straight ahead."""
    views = []
    for i in range(frames):
        pose = np.eye(4)
        pose[0, 3] = -step * i
        views.append(Camera.from_fov(SIZE, SIZE, 60, pose))
    return tuple(views)


def estimate(depth: Float32Array) -> DepthEstimate:
    """The exact depth, as a measurement."""
    return DepthEstimate(depth, "exact", True, is_measured=True)


def small_config(**planar: object) -> ReconstructConfig:
    """The draft preset with an anchor per pixel (the picture is tiny) and every view watched."""
    config = get_preset("draft")
    planar = {"anchors_per_pixel": 1.0, **planar}
    return replace(
        config,
        planar=replace(config.planar, **planar),  # type: ignore[arg-type]
        repair=replace(config.repair, views=0),
    )
