"""Camera files (JSON): poses and intrinsics of a path, one reader for the two forms in use."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from orca.camera import Camera
from orca.errors import BadInput
from orca.json_file import read_json_file

__all__ = ["read_camera_document", "read_cameras"]

_ALLOWED = "JSON with name, width, height, K [3, 3] or [F, 3, 3] and world_to_camera [F, 4, 4]"


def read_camera_document(path: Path) -> dict[str, Any]:
    """Read a camera file into the fields name, width, height, K, world_to_camera, unit, fps (plain lists and numbers).

    Two forms are read: the one `bench.trajectories.Trajectory.to_json` writes, and recovered video cameras
    (``K_512``, ``image_size``, ``video.fps``, poses as rows of 16 numbers).

    Raises:
        BadInput: no such file, not JSON, or a missing field.
    """
    document = read_json_file(Path(path), _ALLOWED, "check the path")
    if not isinstance(document, dict):
        raise BadInput(f"camera file {path} holds a {type(document).__name__}", _ALLOWED, "check the file")
    try:
        return _recovered(document) if "K_512" in document else {key: document[key] for key in _fields(document)}
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise BadInput(f"camera file {path} with a broken field ({error})", _ALLOWED, "check the file") from error


def _fields(document: dict[str, Any]) -> list[str]:
    optional = [key for key in ("unit", "fps") if key in document]
    return ["name", "width", "height", "K", "world_to_camera", *optional]


def _recovered(document: dict[str, Any]) -> dict[str, Any]:
    width, height = document["image_size"]
    return {
        "name": "vistadream",
        "width": int(width),
        "height": int(height),
        "K": document["K_512"],
        "world_to_camera": np.asarray(document["world_to_camera"], np.float64).reshape(-1, 4, 4).tolist(),
        "unit": "R",
        "fps": float(document["video"]["fps"]),
    }


def read_cameras(path: Path) -> tuple[Camera, ...]:
    """The cameras of a camera file, in order; raises `BadInput` for a file that does not hold any."""
    document = read_camera_document(path)
    try:
        poses = np.asarray(document["world_to_camera"], np.float64)
        K = np.asarray(document["K"], np.float64)
        size = int(document["width"]), int(document["height"])
    except (TypeError, ValueError, OverflowError) as error:
        raise BadInput(f"camera file {path} with a broken field ({error})", _ALLOWED, "check the file") from error
    per_frame = np.broadcast_to(K, (len(poses) if poses.ndim else 0, *K.shape)) if K.ndim == 2 else K
    if poses.ndim != 3 or len(poses) == 0 or per_frame.ndim != 3 or len(per_frame) != len(poses):
        raise BadInput(f"camera file {path}: {poses.shape} poses, {K.shape} K", _ALLOWED, "check the file")
    return tuple(Camera(k, pose, *size) for k, pose in zip(per_frame, poses))
