"""Weights files of learned metrics: where they are looked for, their hashes, and what to say when one is missing."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from orca.errors import BadInput, Unavailable

__all__ = ["WeightsFile"]

_DIGITS = 64  # of a whole SHA-256


@dataclass(frozen=True)
class WeightsFile:
    """One file of weights, or one folder of a model.

    Attributes:
        metric: id of the metric that needs it.
        name: its name inside the weights folder.
        source: where a user gets it: the address of the file itself, or of a page of which it is part.
        expected_sha256: its hash, or what that begins with; without one it is never fetched, only named.
    """

    metric: str
    name: str
    source: str
    expected_sha256: str = ""

    @property
    def url(self) -> str:
        """The address of the file itself."""
        if self.source.endswith(self.name):
            return self.source
        on_hub = self.source.startswith("https://huggingface.co/")
        return f"{self.source}{'/resolve/main' if on_hub else ''}/{self.name}"

    def find(self, weights_dir: Path | None) -> Path:
        """Its path; raises `Unavailable`, naming the file and the place, if it is not there."""
        path = self._path(weights_dir)
        if path is not None and path.exists():
            return path
        place = "no weights folder was given" if weights_dir is None else f"not in {weights_dir}"
        raise Unavailable(
            f"{self.metric} needs {self.name}: {place}",
            f"{self.name} inside the folder of --weights-dir",
            f"get it from {self.source} and put it there",
        )

    def sha256(self, weights_dir: Path | None) -> str | None:
        """SHA-256 of the file, or of the names and hashes of a folder's files; None if it is not there."""
        path = self._path(weights_dir)
        if path is None or not path.exists():
            return None
        return _hash_of_folder(path) if path.is_dir() else _hash_of_file(path)

    def check(self, weights_dir: Path | None) -> None:
        """Raise `BadInput` if the file is there and is not the published one."""
        wanted = self.expected_sha256
        if not wanted or (found := self.sha256(weights_dir)) is None or found.startswith(wanted):
            return
        allowed = wanted if len(wanted) == _DIGITS else f"one that begins with {wanted}"
        raise BadInput(
            f"{self._path(weights_dir)} has SHA-256 {found}", allowed, f"get the published file: {self.source}"
        )

    def _path(self, weights_dir: Path | None) -> Path | None:
        return None if weights_dir is None else weights_dir / self.name


def _hash_of_folder(folder: Path) -> str:
    """Hidden folders are left out: download tools keep their notes there."""
    names = sorted(p.relative_to(folder) for p in folder.rglob("*") if p.is_file())
    lines = [f"{n.as_posix()} {_hash_of_file(folder / n)}\n" for n in names if not n.parts[0].startswith(".")]
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def _hash_of_file(path: Path) -> str:
    status = path.stat()
    return _sha256(path, status.st_size, status.st_mtime_ns)


@lru_cache(maxsize=64)
def _sha256(path: Path, size: int, modified_ns: int) -> str:
    """Hash a file once as long as its size and time stay; some weights are hundreds of megabytes."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
