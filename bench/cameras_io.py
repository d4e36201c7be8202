"""Cameras that other programs wrote: our own JSON, nerfstudio's transforms.json, COLMAP's text files.

All of them count pixels as we do (the first centre at 0.5). Nerfstudio stores camera-to-world with OpenGL axes (x
right, y up, z backwards); COLMAP stores world-to-camera with OpenCV's. Only pinhole cameras are read: a lens distortion
that is not zero is refused, since frames rendered with it would be compared with frames rendered without.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from orca.camera import Camera
from orca.camera_file import read_cameras
from orca.conventions import Float64Array
from orca.errors import BadInput
from orca.json_file import parse_json

__all__ = ["MAX_CAMERAS", "NamedCamera", "find_camera_file", "natural_key", "read_camera_file"]

MAX_CAMERAS = 100_000
MAX_BYTES = 64 * 2**20
MAX_SIDE = 32768
_OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
_DISTORTION = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")
_KINDS = "cameras.json (bench cameras), transforms.json (nerfstudio), or COLMAP's cameras.txt and images.txt"
_COLMAP = {"SIMPLE_PINHOLE": 3, "PINHOLE": 4}


@dataclass(frozen=True, eq=False)
class NamedCamera:
    """A camera, and the image file that it belongs to ("" where the camera file names none)."""

    image: str
    camera: Camera


def natural_key(name: str) -> tuple[tuple[int, int | str], ...]:
    """Sorts frame_2 before frame_10."""
    parts = re.findall(r"\d+|\D+", name)
    return tuple((0, int(part)) if part.isdecimal() else (1, part) for part in parts)


def find_camera_file(folder: Path) -> Path | None:
    """The camera file of a scene's folder, or None: a .json, or the folder that holds COLMAP's text files."""
    for name in ("cameras.json", "transforms.json"):
        if (folder / name).is_file():
            return folder / name
    for place in (folder, folder / "sparse" / "0", folder / "sparse"):
        if (place / "cameras.txt").is_file() and (place / "images.txt").is_file():
            return place
    return None


def read_camera_file(path: Path) -> tuple[NamedCamera, ...]:
    """Read the cameras of a file, or of a folder of COLMAP's; ordered by image name where there are names.

    Raises:
        BadInput: no such file, too large, a broken field, or a camera that is no pinhole camera.
    """
    if path.is_dir():
        return _checked(_read_colmap(path), path)
    document = _read_json(path)
    if isinstance(document, dict) and isinstance(document.get("frames"), list):
        return _checked(_read_nerfstudio(document, path), path)
    return _checked([NamedCamera("", camera) for camera in _read_own(path)], path)


def _read_own(path: Path) -> Sequence[Camera]:
    try:
        return read_cameras(path)
    except (OverflowError, RecursionError) as error:
        raise _broken(path, str(error)) from error


def _checked(cameras: Sequence[NamedCamera], path: Path) -> tuple[NamedCamera, ...]:
    """In the order of the image names, which is stable where there are none; of a size that can be rendered."""
    _check_count(len(cameras), path)
    for index, named in enumerate(cameras):
        if max(named.camera.width, named.camera.height) > MAX_SIDE:
            raise _broken(path, f"camera {index} of {named.camera.width}x{named.camera.height} pixels")
        if not _is_rigid(named.camera.world_to_camera):
            raise _broken(path, f"the pose of camera {index} is not a rotation and a translation")
    return tuple(sorted(cameras, key=lambda named: natural_key(named.image)))


def _broken(path: Path, why: str) -> BadInput:
    return BadInput(f"camera file {path}: {why}", _KINDS, "write the file again")


def _check_count(count: int, path: Path) -> None:
    if not 0 < count <= MAX_CAMERAS:
        raise _broken(path, f"{count} cameras, where 1 to {MAX_CAMERAS} are allowed")


def _read_text(path: Path) -> str:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise _broken(path, f"{path.stat().st_size} bytes, where {MAX_BYTES} are allowed")
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise _broken(path, f"cannot be read ({error})") from error


def _read_json(path: Path) -> Any:
    return parse_json(_read_text(path), f"camera file {path}", _KINDS, "write the file again")


def _number(entry: dict[str, Any], common: dict[str, Any], *keys: str) -> float | None:
    """The first of ``keys`` that the frame, or else the whole file, has."""
    for source in (entry, common):
        for key in keys:
            if key in source:
                value = float(source[key])
                if not math.isfinite(value):
                    raise ValueError(f"{key} is {value}")
                return value
    return None


def _read_nerfstudio(document: dict[str, Any], path: Path) -> list[NamedCamera]:
    frames = document["frames"]
    _check_count(len(frames), path)
    cameras = []
    for index, frame in enumerate(frames):
        try:
            cameras.append(_nerfstudio_camera(frame, document))
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            raise _broken(path, f"frame {index}: {error}") from error
    return cameras


def _nerfstudio_camera(frame: dict[str, Any], document: dict[str, Any]) -> NamedCamera:
    model = str(frame.get("camera_model", document.get("camera_model", "OPENCV")))
    if model not in ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE"):
        raise ValueError(f"camera model {model}, where a pinhole camera is needed")
    for key in _DISTORTION:
        if _number(frame, document, key):
            raise ValueError(f"distortion {key} is not zero")
    width, height = _number(frame, document, "w"), _number(frame, document, "h")
    if width is None or height is None:
        raise ValueError("no w and h")
    fx, angle = _number(frame, document, "fl_x"), _number(frame, document, "camera_angle_x")
    if fx is None and angle is not None:
        if not 0 < angle < math.pi:
            raise ValueError(f"camera_angle_x is {angle}")
        fx = 0.5 * width / math.tan(0.5 * angle)
    if fx is None:
        raise ValueError("no fl_x and no camera_angle_x")
    fy = _number(frame, document, "fl_y")
    cx, cy = _number(frame, document, "cx"), _number(frame, document, "cy")
    K = _intrinsics(fx, fx if fy is None else fy, width / 2 if cx is None else cx, height / 2 if cy is None else cy)
    to_world = np.asarray(frame["transform_matrix"], np.float64)
    if to_world.shape == (3, 4):
        to_world = np.vstack([to_world, [0, 0, 0, 1]])
    if to_world.shape != (4, 4) or not np.isfinite(to_world).all():
        raise ValueError(f"transform_matrix of shape {to_world.shape}")
    pose = _inverse(to_world @ _OPENGL_TO_OPENCV)
    return NamedCamera(Path(str(frame.get("file_path", ""))).name, Camera(K, pose, int(width), int(height)))


def _inverse(to_world: Float64Array) -> Float64Array:
    """The inverse of a rigid transform; raises `ValueError` for one that is not rigid."""
    if not _is_rigid(to_world):
        raise ValueError("a pose that is not a rotation and a translation")
    R, pose = to_world[:3, :3], np.eye(4)
    pose[:3, :3], pose[:3, 3] = R.T, -R.T @ to_world[:3, 3]
    return pose


def _is_rigid(pose: Float64Array) -> bool:
    R = pose[:3, :3]
    square = np.abs(R @ R.T - np.eye(3)).max() <= 1e-3 and np.array_equal(pose[3], [0, 0, 0, 1])
    return bool(square and np.linalg.det(R) > 0)


def _intrinsics(fx: float, fy: float, cx: float, cy: float) -> Float64Array:
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])


def _rows(path: Path) -> list[list[str]]:
    return [line.split() for line in _read_text(path).splitlines() if not line.startswith("#")]


def _read_colmap(folder: Path) -> list[NamedCamera]:
    lenses = _colmap_lenses(folder / "cameras.txt")
    path = folder / "images.txt"
    rows = _rows(path)
    while rows and not rows[0]:
        rows.pop(0)
    images = rows[0::2]  # every other line lists the image's points, and may be empty
    _check_count(len(images), path)
    cameras = []
    for index, words in enumerate(images):
        try:
            if len(words) < 10:
                raise ValueError(f"{len(words)} words, where 10 are needed")
            K, width, height = lenses[int(words[8])]
            pose = np.eye(4)
            pose[:3, :3] = _rotation([float(word) for word in words[1:5]])
            pose[:3, 3] = [float(word) for word in words[5:8]]
            cameras.append(NamedCamera(Path(" ".join(words[9:])).name, Camera(K, pose, width, height)))
        except (KeyError, ValueError, OverflowError) as error:
            raise _broken(path, f"image {index}: {error}") from error
    return cameras


def _colmap_lenses(path: Path) -> dict[int, tuple[Float64Array, int, int]]:
    lenses = {}
    for words in filter(None, _rows(path)):
        try:
            count = _COLMAP.get(words[1])
            if count is None or len(words) != 4 + count:
                raise ValueError(f"camera model {words[1]}, where SIMPLE_PINHOLE or PINHOLE is needed")
            values = [float(word) for word in words[4:]]
            fx, fy, cx, cy = values if count == 4 else (values[0], *values)
            lenses[int(words[0])] = (_intrinsics(fx, fy, cx, cy), int(words[2]), int(words[3]))
        except (IndexError, ValueError, OverflowError) as error:
            raise _broken(path, f"{' '.join(words[:4])[:80]}: {error}") from error
    return lenses


def _rotation(wxyz: list[float]) -> Float64Array:
    """Rotation matrix of a quaternion; raises `ValueError` for one without a length."""
    norm = math.sqrt(sum(c * c for c in wxyz))
    if not (math.isfinite(norm) and norm > 1e-6):
        raise ValueError(f"a quaternion of length {norm:g}")
    w, x, y, z = (c / norm for c in wxyz)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
