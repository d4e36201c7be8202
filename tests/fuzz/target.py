"""What a target of fuzzing is, and where its inputs are written."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from orca.errors import OrcaError

__all__ = ["Target", "each", "folder", "input_file", "refused_or_read"]


@dataclass(frozen=True)
class Target:
    """A parser.

    Attributes:
        read: gives it the bytes; raises what the parser raises.
        reads: the functions behind it, for the table.
        max_bytes: of one input.
        native: most of it is compiled code that is not instrumented.
        json: inputs are JSON, and are changed as such.
        marked: their first byte is not part of it.
        instrument: packages of others whose Python code is read along.
    """

    read: Callable[[bytes], None]
    reads: str
    max_bytes: int = 4096
    native: bool = False
    json: bool = False
    marked: bool = False
    instrument: tuple[str, ...] = ()


def refused_or_read(target: Target, content: bytes) -> str | None:
    """ "read", or the kind of the error it was refused with. Whatever else is raised is a finding."""
    try:
        target.read(content)
    except OrcaError as error:
        return error.kind
    return "read"


def each(*reads: Callable[[], object]) -> None:
    """Call every reader, also after one that refuses; then raise the last refusal."""
    refused = None
    for read in reads:
        try:
            read()
        except OrcaError as error:
            refused = error
    if refused is not None:
        raise refused


@cache
def folder() -> Path:
    """A folder in memory, where there is one: thousands of files a second are written into it. Removed at the end."""
    memory = Path("/dev/shm")
    place = tempfile.mkdtemp(prefix=f"orca-fuzz-{os.getpid()}-", dir=memory if os.access(memory, os.W_OK) else None)
    atexit.register(shutil.rmtree, place, ignore_errors=True)
    return Path(place)


def input_file(name: str, content: bytes) -> Path:
    """An input as a file of that name."""
    path = folder() / name
    path.write_bytes(content)
    return path
