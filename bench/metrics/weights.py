"""Weights files of learned metrics: where they are looked for, their hashes, and what to say when one is missing."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from orca.errors import Unavailable

__all__ = ["WeightsFile"]


@dataclass(frozen=True)
class WeightsFile:
    """One file of weights, or one folder of a model.

    Attributes:
        metric: id of the metric that needs it.
        name: its name inside the weights folder.
        source: where a user gets it.
    """

    metric: str
    name: str
    source: str

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
        """SHA-256 of the file, or None if it is not there (or is a folder)."""
        path = self._path(weights_dir)
        if path is None or not path.is_file():
            return None
        status = path.stat()
        return _sha256(path, status.st_size, status.st_mtime_ns)

    def _path(self, weights_dir: Path | None) -> Path | None:
        return None if weights_dir is None else weights_dir / self.name


@lru_cache(maxsize=16)
def _sha256(path: Path, size: int, modified_ns: int) -> str:
    """Hash a file once as long as its size and time stay; some weights are hundreds of megabytes."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
