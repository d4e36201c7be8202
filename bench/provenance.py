"""What a result was made from: hashes of the scene and the method's views, input files, state of the code."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.adapters.adapter import MethodOutput
from bench.datasets.case import SceneCase
from bench.digest import digest

__all__ = ["FileListing", "case_hashes", "code_state", "data_block", "file_sha256", "input_files", "output_hashes"]

_DEPTH = 3  # how far below a data folder its files may lie
_ENDS = re.compile(r"[._]")  # what may follow a scene's name in that of its file


def case_hashes(case: SceneCase) -> dict[str, str]:
    """SHA-256 of everything a method or a metric is told of a scene, decoded: part -> hash.

    Parts: image, depth, camera, trajectory (of the whole path and the evaluated indices) and, where there are any,
    true_views. Only contents count, no file name and no order of a directory.
    """
    lens = _of_camera(case.camera)
    parts = {
        "image": _array(case.image),
        "depth": _text(_array(case.depth), str(case.depth_is_metric), str(case.depth_is_measured)),
        "camera": lens,
        "trajectory": _text(case.trajectory.sha256, *map(str, case.eval_indices)),
    }
    if case.true_views:
        views = [
            _text(_of_camera(v.camera), _array(v.image), _array(v.hidden), *_extra(v.depth), *_extra(v.occluder_depth))
            for v in case.true_views
        ]
        parts["true_views"] = _text(*views)
    return parts


def output_hashes(output: MethodOutput) -> dict[str, str]:
    """SHA-256 of what a method returned besides its frames: part -> hash; a part it did not give is absent."""
    parts: dict[str, str] = {}
    for name in ("coverage", "input_view", "frame_depth"):
        array = getattr(output, name)
        if array is not None:
            parts[name] = _array(array)
    for name in ("true_views", "true_view_coverage", "true_view_depth"):
        arrays: Iterable[NDArray[Any]] | None = getattr(output, name)
        if arrays is not None:
            parts[name] = _text(*(_array(array) for array in arrays))
    return parts


def data_block(scenes: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """What the scenes of a run were made of, and one revision over it: it changes when any input of any scene does."""
    ordered = {name: dict(scenes[name]) for name in sorted(scenes)}
    return {"revision": digest(ordered), "scenes": ordered}


def input_files(
    data_root: Path | None,
    images: Path | None,
    folders: Sequence[str],
    scene: str,
    listing: FileListing | None = None,
) -> dict[str, str]:
    """Files named after the scene: path below the data root (or below ``images``) -> SHA-256.

    Looked for in the sub-folders ``folders`` of the data root (the data set's, and the method's for one that reads its
    frames from files) and in ``images``; a file belongs to a scene when its name begins with the scene's and goes on
    with a dot, an underscore, or not at all. With a ``listing`` a folder is looked through once for all scenes.
    """
    found: dict[str, str] = {}
    listing = listing or FileListing()
    for root in (data_root, images):
        if root is not None:
            starts = [root] if root is images else [root / folder for folder in folders]
            for path in (path for start in dict.fromkeys(starts) for path in listing.of_scene(start, scene)):
                if path.is_file():  # still
                    found[path.relative_to(root).as_posix()] = file_sha256(path)
    return dict(sorted(found.items()))


class FileListing:
    """The files of folders, ``_DEPTH`` levels down, by the scenes that they may belong to; each folder is read once."""

    def __init__(self) -> None:
        self._by_scene: dict[Path, dict[str, list[Path]]] = {}

    def of_scene(self, folder: Path, scene: str) -> list[Path]:
        """Files below the folder whose names begin with the scene's and go on with a dot, an underscore, or not."""
        if folder not in self._by_scene:
            self._by_scene[folder] = self._read(folder)
        return self._by_scene[folder].get(scene, [])

    def _read(self, folder: Path) -> dict[str, list[Path]]:
        found: dict[str, list[Path]] = {}
        for directory, below, names in os.walk(folder):
            if len(Path(directory).relative_to(folder).parts) >= _DEPTH:
                below.clear()
            for name in names:
                for scene in {name, *(name[: mark.start()] for mark in _ENDS.finditer(name))}:
                    found.setdefault(scene, []).append(Path(directory) / name)
        return found


def file_sha256(path: Path) -> str:
    """SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@cache
def code_state() -> dict[str, Any]:
    """The git commit of this code, and whether the files on disk differ from it; nulls where that cannot be known."""
    here = Path(__file__).resolve().parents[1]
    if shutil.which("git") is None or not (here / ".git").exists():  # an installed package has no commit
        return {"commit": None, "dirty": None}
    commit = _git(here, "rev-parse", "HEAD")
    changes = _git(here, "status", "--porcelain", "--untracked-files=no")
    return {"commit": commit or None, "dirty": None if changes is None else bool(changes)}


def _git(folder: Path, *arguments: str) -> str | None:
    done = subprocess.run(["git", "-C", str(folder), *arguments], capture_output=True, text=True, check=False)
    return done.stdout.strip() if done.returncode == 0 else None


def _of_camera(camera: Any) -> str:
    size = f"{camera.width}x{camera.height}"
    return _text(size, _array(np.round(camera.K, 9) + 0.0), _array(np.round(camera.world_to_camera, 9) + 0.0))


def _extra(array: NDArray[Any] | None) -> tuple[str, ...]:
    return () if array is None else (_array(array),)


def _array(array: NDArray[Any]) -> str:
    plain = np.ascontiguousarray(array)
    hasher = hashlib.sha256(f"{plain.dtype.str} {plain.shape}".encode())
    hasher.update(plain.data if plain.size else b"")
    return hasher.hexdigest()


def _text(*parts: str) -> str:
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()
