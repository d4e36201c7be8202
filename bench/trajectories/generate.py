"""Named trajectories, trajectories from files, and how two of them differ."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bench.trajectories.trajectory import Trajectory
from orca.atomic import atomic_path
from orca.camera import Camera
from orca.camera_file import read_camera_document
from orca.conventions import Float64Array
from orca.errors import BadInput
from orca.paths import PATHS, make_path

__all__ = [
    "EVAL_FRAMES",
    "build_trajectory",
    "evenly_spaced",
    "first_difference",
    "from_poses",
    "list_trajectories",
    "load_trajectory",
    "save_trajectory",
]

EVAL_FRAMES = 50  # the paper: "50 frames sampled from the rendered video"


def list_trajectories() -> dict[str, str]:
    """Name -> one-line description of every named trajectory."""
    return {name: path.description for name, path in PATHS.items()}


def from_poses(name: str, poses: Float64Array, camera: Camera, fps: float = 20.0) -> Trajectory:
    """A trajectory in units of R from world-to-camera poses [F, 4, 4], with the K and size of ``camera``."""
    return Trajectory(name, camera.K, poses, camera.width, camera.height, "R", fps)


def build_trajectory(spec: str, camera: Camera, frames: int | None = None) -> Trajectory:
    """A named path with the intrinsics of ``camera``, or the content of a ``.json`` camera file.

    Raises:
        Unknown: no such name.
        BadInput: a broken file, or cameras of another image size than ``camera``.
    """
    if not spec.lower().endswith(".json"):
        return from_poses(spec, make_path(spec, frames), camera)
    loaded = load_trajectory(Path(spec))
    if (loaded.width, loaded.height) != (camera.width, camera.height):
        raise BadInput(
            f"cameras of {loaded.width}x{loaded.height} pixels in {spec} for an image of "
            f"{camera.width}x{camera.height}",
            "cameras of the size of the input image",
            "resize the image, or write the camera file for its size",
        )
    return loaded


def load_trajectory(path: Path) -> Trajectory:
    """Read a camera file; raises `BadInput` when it is missing or broken."""
    return Trajectory.from_json(read_camera_document(path))


def save_trajectory(trajectory: Trajectory, path: Path) -> None:
    """Write a camera file that `load_trajectory` reads back with the same hash."""
    import json

    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(trajectory.to_json()), encoding="utf-8")


def evenly_spaced(n_frames: int, n: int = EVAL_FRAMES) -> tuple[int, ...]:
    """``linspace(0, n_frames - 1, n)`` rounded to whole frames; every frame once if there are fewer than ``n``."""
    if n_frames < 1 or n < 1:
        raise BadInput(f"{n} of {n_frames} frames", "at least one of at least one", "ask for more frames")
    return tuple(int(i) for i in np.round(np.linspace(0, n_frames - 1, min(n, n_frames))))


def first_difference(a: Trajectory, b: Trajectory) -> int | None:
    """The first frame whose view differs (K or pose, at the 1e-9 of the hash), or None if all views are the same.

    Another image size or unit changes every view: 0. If one path only ends earlier: the length of the shorter.
    The name is no part of a view; two trajectories of the same views under two names have different hashes and None.
    """
    if (a.width, a.height, a.unit) != (b.width, b.height, b.unit):
        return 0
    shared = min(len(a), len(b))
    same = np.ones(shared, np.bool_)
    for ours, theirs in ((a.K, b.K), (a.world_to_camera, b.world_to_camera)):
        same &= (np.round(ours[:shared], 9) == np.round(theirs[:shared], 9)).all(axis=(1, 2))
    if not same.all():
        return int(np.argmin(same))
    return None if len(a) == len(b) else shared
