"""Results on disk: one atomic JSON a cell, readable with any tool, never half written."""

from __future__ import annotations

import fcntl
import json
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from bench.digest import sealed, unsealed
from bench.record import READABLE, SCHEMA_VERSION, CellRecord, jsonable
from bench.trajectories.trajectory import Trajectory
from orca.atomic import atomic_path, output_folder
from orca.errors import BadInput, CannotWrite
from orca.json_file import read_json_file

__all__ = ["RunStore", "read_json", "write_atomic", "write_json"]


def write_atomic(path: Path, content: bytes) -> None:
    """Write a file so that a reader, or a crash, sees the old one or the new one and nothing between."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def write_json(path: Path, document: Any) -> None:
    """Write a JSON file atomically; non-finite numbers are written as `jsonable` says."""
    text = json.dumps(jsonable(document), indent=1, allow_nan=False, ensure_ascii=False)
    write_atomic(path, (text + "\n").encode())


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object; raises `BadInput`, naming the file, for anything else."""
    allowed, fix = "the JSON object that bench run wrote", "delete the file and run again, or choose another --out"
    document = read_json_file(path, allowed, fix)
    if not isinstance(document, dict):
        raise BadInput(f"{path} holds a {type(document).__name__}", allowed, fix)
    return document


# Of which type the parts of run.json are, where they are there; and those that are names or paths.
_PARTS: dict[str, type] = {
    **dict.fromkeys(("identity", "method_versions", "metric_specs", "preset_config", "folders"), dict),
    **dict.fromkeys(("code", "data", "timing", "host"), dict),
    **dict.fromkeys(("scenes", "methods", "metrics", "commands", "argv"), list),
}
_NAMES = {"identity": ("dataset", "images", "trajectory", "preset", "device", "codec"), "timing": ("started",)}


def _is_run(document: dict[str, Any]) -> bool:
    """Whether the parts that everybody reads are of the types that they are read as."""
    if "identity" not in document or not all(isinstance(document.get(k, t()), t) for k, t in _PARTS.items()):
        return False
    words = [document.get("started"), *document.get("folders", {}).values()]
    words += [document.get(part, {}).get(name) for part, names in _NAMES.items() for name in names]
    listed = [name for part in ("scenes", "methods", "metrics") for name in document.get(part, ())]
    if type(document["identity"].get("seed", 0)) is not int:
        return False
    return all(word is None or isinstance(word, str) for word in words) and all(isinstance(n, str) for n in listed)


def _present_form(document: dict[str, Any]) -> dict[str, Any]:
    """A run of schema version 1 kept its start beside the rest and knew no codec."""
    plain = unsealed(document)
    started = plain.pop("started", None)
    timing = {**({} if started is None else {"started": started}), **plain.get("timing", {})}
    identity = dict(plain["identity"])
    identity.setdefault("codec", None)
    return {**plain, "schema_version": SCHEMA_VERSION, "identity": identity, "timing": timing}


class RunStore:
    """The folder of one run.

    ``run.json``, ``scenes/<method>/<scene>.json``, ``frames/<method>/<scene>.npz``, ``trajectories/<sha256>.json``,
    ``tables/``, ``scores.parquet`` (every score in one long table), ``cache/scores/`` (by content), and
    ``work/<method>/<scene>/`` for what a method leaves behind.

    Args:
        root: the folder; made when the first file is written.
    """

    def __init__(self, root: Path) -> None:
        self.root = Path(root)

    def record_path(self, method: str, scene: str) -> Path:
        """Where the result of a cell lies. Raises `BadInput` for a name that would leave the folder."""
        return self._cell("scenes", method, scene, ".json")

    def frames_path(self, method: str, scene: str) -> Path:
        """Where the scored frames of a cell lie."""
        return self._cell("frames", method, scene, ".npz")

    def work_path(self, method: str, scene: str) -> Path:
        """Where a method leaves files of its own."""
        return self._cell("work", method, scene, "")

    def fresh_work_dir(self, method: str, scene: str) -> Path:
        """An empty folder for the method's own files: nothing of an older version of the method is left in it."""
        folder = self.work_path(method, scene)
        shutil.rmtree(folder, ignore_errors=True)
        return output_folder(folder)

    def drop_empty_work_dir(self, method: str, scene: str) -> None:
        """Remove the work folder of a method that left nothing in it."""
        folder = self.work_path(method, scene)
        if folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()

    def record_paths(self) -> list[Path]:
        """The file of every result in the folder, by method and scene name; what a killed writer leaves is none."""
        return [p for p in sorted((self.root / "scenes").glob("*/*.json")) if not p.name.startswith(".")]

    def load(self, method: str, scene: str) -> CellRecord | None:
        """The result of a cell, or None when there is none. Raises `BadInput` for a broken file."""
        path = self.record_path(method, scene)
        return CellRecord.from_json(read_json(path), str(path)) if path.is_file() else None

    def save(self, record: CellRecord) -> None:
        """Write the result of a cell, atomically."""
        write_json(self.record_path(record.method, record.scene), record.to_json())

    def documents(self) -> Iterator[tuple[Path, dict[str, Any]]]:
        """The file and the raw JSON of every result, by method and scene name. Raises `BadInput` for a broken file."""
        for path in self.record_paths():
            yield path, read_json(path)

    def records(self) -> Iterator[CellRecord]:
        """Every result in the folder, by method and scene name."""
        for path, document in self.documents():
            yield CellRecord.from_json(document, str(path))

    @property
    def summary_path(self) -> Path:
        """Where the long table of all scores lies."""
        return self.root / "scores.parquet"

    def summary_is_stale(self) -> bool:
        """True if a result is younger than the long table, which a run that was killed did not come to write."""
        if not self.summary_path.is_file():
            return True
        written = self.summary_path.stat().st_mtime_ns
        return any(path.stat().st_mtime_ns > written for path in self.record_paths())

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Hold back other processes, here or on machines that share the folder, that would change ``run.json`` too.

        Results need no such thing: each is one file, written whole. Raises `CannotWrite` for a folder nobody may write.
        """
        output_folder(self.root)
        try:
            file = (self.root / ".lock").open("w")
        except OSError as error:
            raise CannotWrite(
                f"cannot write into '{self.root}' ({error.strerror})", "a writable folder", "--out"
            ) from error
        with file:
            fcntl.flock(file, fcntl.LOCK_EX)
            yield

    @property
    def run_path(self) -> Path:
        """Where the description of the run lies."""
        return self.root / "run.json"

    def load_run(self) -> dict[str, Any] | None:
        """The contents of ``run.json`` in today's form, whichever schema version wrote it; None for a new folder.

        Raises `BadInput` for a file that is not one.
        """
        if not self.run_path.is_file():
            return None
        document = read_json(self.run_path)
        if document.get("schema_version") not in READABLE or not _is_run(document):
            raise BadInput(
                f"{self.run_path} is not the description of a run (schema_version {document.get('schema_version')})",
                f"schema_version {' or '.join(map(str, READABLE))}, as bench run writes it",
                "delete the file and run again, or choose another --out",
            )
        return _present_form(document)

    def save_run(self, document: dict[str, Any]) -> None:
        """Write ``run.json`` under a seal, atomically."""
        write_json(self.run_path, sealed(jsonable(document)))

    def save_trajectory(self, trajectory: Trajectory) -> None:
        """Keep the cameras of a result beside it, under their hash."""
        path = self.root / "trajectories" / f"{trajectory.sha256}.json"
        if not path.is_file():
            write_json(path, trajectory.to_json())

    def load_trajectory(self, sha256: str) -> Trajectory | None:
        """The cameras with that hash, or None if this run has none, or it is no hash."""
        if not re.fullmatch("[0-9a-f]{64}", sha256):
            return None
        path = self.root / "trajectories" / f"{sha256}.json"
        return Trajectory.from_json(read_json(path)) if path.is_file() else None

    def _cell(self, kind: str, method: str, scene: str, suffix: str) -> Path:
        for name in (method, scene):
            if not name or name.startswith(".") or "/" in name or "\\" in name or "\0" in name:
                raise BadInput(
                    f"the name {name!r}", "a name that can be a file name: no slash, no leading dot", "rename the image"
                )
        return self.root / kind / method / f"{scene}{suffix}"
