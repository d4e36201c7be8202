"""RealmDreamer's 11 images with depth, along the path of VistaDream's published videos.

Files under ``<data_root>/realmdreamer``: ``images/<scene>.png`` (512x512 RGB), ``depth/<scene>.png`` (uint16, z-depth
in 1e-4 R), ``scenes.json`` (per scene: ``fx_512``, ``forward_ratio``, ``backward_ratio``). The unit R is that of the
published cameras. It is stored with the data and not computed anew from the depth: `scene_radius` of these maps is
0.986 to 0.996 in ten scenes, but 3.04 in car, where far pixels take part that VistaDream left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bench.datasets.assemble import check_scene, checked_depth
from bench.datasets.case import Dataset, SceneCase
from bench.datasets.catalogue import DatasetOptions, resolve_data_root
from bench.trajectories import Trajectory, build_trajectory, evenly_spaced, from_poses
from orca.array_file import read_png
from orca.camera import Camera
from orca.conventions import Float32Array, UInt8Array
from orca.errors import BadInput, Unavailable
from orca.images import load_image
from orca.json_file import read_json_file
from orca.paths import vistadream

__all__ = ["SCENES", "RealmDreamer", "open_realmdreamer"]

SCENES = (
    "bathroom",
    "bear",
    "bedroom3",
    "bust",
    "car",
    "kitchen",
    "lavender",
    "living_room",
    "piano",
    "steampunk",
    "victorian",
)
VISTADREAM_FRAMES = 250
VISTADREAM_FPS = 20.0
_DEPTH_STEP = 1e-4  # R per unit of the uint16 depth maps


def open_realmdreamer(options: DatasetOptions) -> Dataset:
    """The factory of the registry."""
    return RealmDreamer(resolve_data_root(options.data_root), options.trajectory or "vistadream")


class RealmDreamer:
    """The data set under ``<data_root>/realmdreamer``; ``trajectory`` is a path's name or a .json camera file."""

    name = "realmdreamer"

    def __init__(self, data_root: Path, trajectory: str = "vistadream") -> None:
        self._root = Path(data_root) / self.name
        self._trajectory = trajectory

    def scenes(self) -> Sequence[str]:
        """The 11 scenes, in the paper's order. Raises `Unavailable` when there is no such data set in the data root."""
        self._catalogue()
        return SCENES

    def load(self, scene: str) -> SceneCase:
        """Read one scene. Raises `Unknown` for a wrong name, `Unavailable` or `BadInput` for its files."""
        entry = self._entry(check_scene(scene, SCENES, self.name))
        image = load_image(self._file("images", scene))
        camera = _camera(entry, image)
        trajectory = self._path(entry, camera)
        return SceneCase(
            dataset=self.name,
            name=scene,
            image=image,
            camera=camera,
            depth=_read_depth(self._file("depth", scene), image),
            depth_source="Depth Pro via VistaDream's published depth video",
            depth_is_metric=True,
            fov_source="VistaDream's published cameras",
            trajectory=trajectory,
            eval_indices=evenly_spaced(len(trajectory)),
        )

    def published_trajectory(self, scene: str, camera: Camera) -> Trajectory:
        """VistaDream's path in this scene, with the intrinsics of ``camera``, whatever path the data set was given."""
        return _vistadream(self._entry(check_scene(scene, SCENES, self.name)), camera)

    def _path(self, entry: dict[str, Any], camera: Camera) -> Trajectory:
        if self._trajectory == "vistadream":
            return _vistadream(entry, camera)
        return build_trajectory(self._trajectory, camera)

    def _entry(self, scene: str) -> dict[str, Any]:
        entry = self._catalogue().get(scene)
        fields = ("fx_512", "forward_ratio", "backward_ratio")
        if not isinstance(entry, dict) or not all(_is_number(entry.get(field)) for field in fields):
            raise BadInput(
                f"{self._root / 'scenes.json'} without a complete entry for '{scene}'",
                "fx_512, forward_ratio and backward_ratio per scene",
                "get scenes.json again",
            )
        return entry

    def _catalogue(self) -> dict[str, Any]:
        path = self._root / "scenes.json"
        if not path.is_file():
            raise self._missing(path)
        catalogue = read_json_file(path, "scenes.json", "get scenes.json again")
        if not isinstance(catalogue, dict):
            raise BadInput(f"{path} holds a {type(catalogue).__name__}", "an object", "get scenes.json again")
        return catalogue

    def _file(self, folder: str, scene: str) -> Path:
        path = self._root / folder / f"{scene}.png"
        if not path.is_file():
            raise self._missing(path)
        return path

    def _missing(self, path: Path) -> Unavailable:
        return Unavailable(
            f"data set 'realmdreamer' is not complete: no {path}",
            f"images/*.png, depth/*.png and scenes.json under {self._root}",
            "put the files there, or name their parent folder with --data-root or ORCA_DATA_ROOT "
            "(images: repository jaidevshriram/realmdreamer, data/images)",
        )


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e9  # nor NaN


def _vistadream(entry: dict[str, Any], camera: Camera) -> Trajectory:
    poses = vistadream(VISTADREAM_FRAMES, 1.0, float(entry["forward_ratio"]), float(entry["backward_ratio"]))
    return from_poses("vistadream", poses, camera, VISTADREAM_FPS)


def _camera(entry: dict[str, Any], image: UInt8Array) -> Camera:
    """Square pixels, principal point at the centre; ``fx_512`` belongs to a width of 512."""
    height, width = image.shape[:2]
    f = float(entry["fx_512"]) * width / 512
    return Camera(np.array([[f, 0, width / 2], [0, f, height / 2], [0, 0, 1]]), np.eye(4), width, height)


def _read_depth(path: Path, image: UInt8Array) -> Float32Array:
    """z-depth in R, [H, W] float32. The format ends at 6.5535 R: what lies farther is stored at that limit."""
    stored = read_png(path)
    if stored.dtype != np.uint16:
        raise BadInput(f"depth map {path} is of type {stored.dtype}", "a 16-bit grey PNG in 1e-4 R", "get it again")
    return checked_depth(stored, image, str(path)) * np.float32(_DEPTH_STEP)
