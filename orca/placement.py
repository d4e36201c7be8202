"""Which cameras: the input's field of view, and a camera path in the units of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from orca.camera import Camera
from orca.camera_file import read_camera_document, read_cameras
from orca.errors import BadInput
from orca.paths import make_path, path_cameras

__all__ = ["DEFAULT_HFOV_DEG", "FieldOfView", "choose_field_of_view", "path_in_scene_radii"]

DEFAULT_HFOV_DEG = 60.0


@dataclass(frozen=True)
class FieldOfView:
    """A horizontal field of view in degrees, and who says so."""

    degrees: float
    source: str


def choose_field_of_view(given: float | None, from_depth: float | None, trajectory: str) -> FieldOfView:
    """The user's; else the depth provider's; else that of the camera file whose first camera is the input's; else 60.

    Args:
        given: what the user asked for, in degrees.
        from_depth: what the depth provider knows.
        trajectory: name of a path, or of a camera file.
    """
    if given is not None:
        return FieldOfView(given, "given")
    if from_depth is not None:
        return FieldOfView(from_depth, "depth provider")
    if trajectory.endswith(".json"):
        first = read_cameras(Path(trajectory))[0]
        if np.allclose(first.world_to_camera, np.eye(4), atol=1e-6):
            return FieldOfView(first.hfov_deg, f"camera file {Path(trajectory).name}")
    return FieldOfView(DEFAULT_HFOV_DEG, f"assumed, {DEFAULT_HFOV_DEG:g} degrees")


def path_in_scene_radii(
    trajectory: str, frames: int | None, input_camera: Camera, radius: float = 1.0
) -> tuple[Camera, ...]:
    """Cameras of a named path or a camera file, translations in units of the scene radius R.

    A named path takes intrinsics and size of the input camera; a file brings its own. A file in another unit than
    "R" is taken to be in the unit of the depth that the scene was made from, and divided by ``radius``.

    Args:
        trajectory: name of a path, or a path ending in .json.
        frames: how many; evenly spaced ones of a file, and the path's own number when left out.
        input_camera: the input view.
        radius: length of R in the unit of the depth.

    Raises:
        Unknown: no such path.
        BadInput: a broken camera file, or too few frames.
    """
    if not trajectory.endswith(".json"):
        return path_cameras(make_path(trajectory, frames), input_camera)
    path = Path(trajectory)
    cameras: Sequence[Camera] = read_cameras(path)
    if frames is not None:
        if frames < 1:
            raise BadInput(f"{frames} frames", "1 or more", "ask for more frames")
        chosen = np.linspace(0, len(cameras) - 1, min(frames, len(cameras))).round().astype(int)
        cameras = [cameras[i] for i in chosen]
    if read_camera_document(path).get("unit", "R") != "R":
        cameras = [_scaled(camera, 1.0 / radius) for camera in cameras]
    return tuple(cameras)


def _scaled(camera: Camera, factor: float) -> Camera:
    """The same camera in a world ``factor`` times as large."""
    pose = camera.world_to_camera.copy()
    pose[:3, 3] *= factor
    return replace(camera, world_to_camera=pose)
