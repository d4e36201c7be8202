"""Where the files of a scene lie in a folder that a user names, and a fingerprint of that folder."""

from __future__ import annotations

import glob
import hashlib
from collections.abc import Sequence
from pathlib import Path

from orca.errors import BadInput, Unavailable

__all__ = ["fingerprint", "one_of", "scene_file"]


def fingerprint(path: Path) -> str:
    """12 hex digits over names, sizes and change times of all files below ``path``.

    Part of a method's version: frames that were rendered anew into the same folder are scored anew.
    """
    digest = hashlib.sha256()
    for file in sorted(p for p in path.rglob("*") if p.is_file()):
        facts = file.stat()
        digest.update(f"{file.relative_to(path).as_posix()}\0{facts.st_size}\0{facts.st_mtime_ns}\n".encode())
    return digest.hexdigest()[:12]


def one_of(path: Path, scene: str, names: Sequence[str], what: str) -> Path:
    """The first of ``names`` (with ``{scene}`` in them) that is a file below ``path``.

    Raises:
        BadInput: a scene name that would leave the folder.
        Unavailable: none of them is there.
    """
    if not scene or scene != Path(scene).name or scene.startswith("."):
        raise BadInput(f"scene name {scene!r}", "a plain file name", "rename the scene")
    tried = [name.format(scene=scene) for name in names]
    for name in tried:
        if (path / name).is_file():
            return path / name
    raise Unavailable(f"no {what} of scene '{scene}' in {path}", ", ".join(tried), "put it there, or check the path")


def scene_file(path: Path, scene: str, suffix: str, what: str) -> Path:
    """``<scene><suffix>``, else the one file ``*<suffix>`` in the folder ``<scene>``.

    Raises:
        BadInput: two such files in the folder.
        Unavailable: none.
    """
    direct = path / f"{scene}{suffix}"
    inside = sorted(path.glob(f"{glob.escape(scene)}/*{suffix}"))
    if direct.is_file() or not inside:
        return one_of(path, scene, (f"{{scene}}{suffix}", f"{{scene}}/{{scene}}{suffix}"), what)
    if len(inside) > 1:
        names = ", ".join(file.name for file in inside[:3])
        raise BadInput(f"{len(inside)} files for scene '{scene}': {names}", f"one *{suffix}", "leave one of them there")
    return inside[0]
