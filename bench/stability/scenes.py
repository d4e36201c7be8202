"""What the generated cases are made of: a small textured picture, a depth with an object in it, and a path."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bench.datasets.case import SceneCase
from bench.trajectories import Trajectory, from_poses
from orca.camera import Camera
from orca.conventions import Float32Array, Float64Array, UInt8Array, to_uint8
from orca.paths import make_path

__all__ = ["FRAMES", "HFOV_DEG", "SIZE", "make_scene", "object_depth", "picture", "turn", "write_picture"]

SIZE = 128
FRAMES = 5
HFOV_DEG = 60.0


def picture(width: int = SIZE, height: int = SIZE) -> UInt8Array:
    """A smooth coloured background with a striped disc in front, [H, W, 3]."""
    x, y = np.meshgrid(np.linspace(-1, 1, width), np.linspace(-1, 1, height))
    waves = [0.5 + 0.25 * np.sin(3 * x + phase) + 0.2 * np.cos(4 * y - phase) for phase in (0.0, 1.0, 2.0)]
    colour = np.stack(waves, axis=2)
    stripes = 0.5 + 0.4 * np.sign(np.sin(9 * (x + y)))
    disc = _disc(x, y)
    colour[disc] = np.stack([stripes, 0.3 + 0 * stripes, 1 - stripes], axis=2)[disc]
    return to_uint8(colour)


def object_depth(width: int = SIZE, height: int = SIZE) -> Float32Array:
    """z-depth of that picture in scene radii: a floor that recedes, and the disc at half its distance, [H, W]."""
    x, y = np.meshgrid(np.linspace(-1, 1, width), np.linspace(-1, 1, height))
    depth = 1.2 - 0.3 * y + 0.1 * x
    depth[_disc(x, y)] = 0.6
    return depth.astype(np.float32)


def _disc(x: Float64Array, y: Float64Array) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    return np.asarray((x - 0.1) ** 2 + (y - 0.15) ** 2 < 0.16)


def make_scene(
    image: UInt8Array | None = None,
    depth: Float32Array | None = None,
    poses: Float64Array | None = None,
    camera: Camera | None = None,
    trajectory: Trajectory | None = None,
) -> SceneCase:
    """A scene case; the default image, depth, camera (60 degrees) and path (swing, 5 frames) where none is given.

    Depth is handed on as it is, whatever is wrong with it.
    """
    rgb = picture() if image is None else image
    height, width = rgb.shape[:2]
    view = camera or Camera.from_fov(width, height, HFOV_DEG)
    path = trajectory or from_poses("stability", make_path("swing", FRAMES) if poses is None else poses, view)
    return SceneCase(
        dataset="stability",
        name="scene",
        image=rgb,
        camera=view,
        depth=object_depth(width, height) if depth is None else depth,
        depth_source="made for the case",
        depth_is_metric=True,
        fov_source="made for the case",
        trajectory=path,
        eval_indices=tuple(range(len(path))),
    )


def turn(degrees: float, frames: int = FRAMES) -> Float64Array:
    """World-to-camera poses that turn on the spot about the vertical axis, from 0 to ``degrees``, [F, 4, 4]."""
    poses = np.tile(np.eye(4), (frames, 1, 1))
    for pose, angle in zip(poses, np.radians(np.linspace(0, degrees, frames)), strict=True):
        pose[:3, :3] = [[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]]
    return poses


def write_picture(path: Path, image: UInt8Array | None = None) -> Path:
    """The picture as a file."""
    from PIL import Image

    Image.fromarray(picture() if image is None else image).save(path)
    return path
