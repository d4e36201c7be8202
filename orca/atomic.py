"""Files appear whole or not at all: the one place where this project gives a file its name."""

from __future__ import annotations

import errno
import hashlib
import os
import platform
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

from orca.errors import BadInput, CannotWrite
from orca.faults import fault_point

__all__ = ["atomic_path", "drop_unfinished", "output_folder"]

# What the disk, not the caller, is to blame for: full, over quota, read-only, broken, too large a file.
_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO, errno.EFBIG)


@contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path in the same folder; it takes the name ``path`` only if the block succeeds.

    The content is on the disk before the name is, so that neither a kill nor a loss of power leaves a part of a file.
    The suffix is kept, for writers that choose the format by it. Missing folders are created. What a killed process
    leaves begins with a dot and is found by `drop_unfinished`.

    Raises:
        BadInput: ``path`` is a folder.
        CannotWrite: its folder cannot be made or written, or the disk is full or broken.
    """
    target = Path(path)
    if target.is_dir():
        raise BadInput(f"'{target}' is a folder", "a file name", "add a file name to the path")
    output_folder(target.parent)
    try:
        fault_point("start", target)
        handle, name = tempfile.mkstemp(
            prefix=f".{target.stem[:100]}{_owner()}", suffix=target.suffix, dir=target.parent
        )
    except OSError as error:
        raise _cannot_write(target, error) from error
    os.close(handle)
    temporary = Path(name)
    try:
        fault_point("made", target)
        yield temporary
        _finish(temporary, target)
    except Exception as error:
        if getattr(error, "errno", None) in _DISK and not isinstance(error, CannotWrite):
            raise _cannot_write(target, error) from error
        raise
    finally:
        temporary.unlink(missing_ok=True)


def _finish(temporary: Path, target: Path) -> None:
    fault_point("half", target, temporary)
    umask = os.umask(0)
    os.umask(umask)
    temporary.chmod(0o666 & ~umask)  # mkstemp makes files private; an ordinary file follows the umask
    handle = os.open(temporary, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
    fault_point("written", target, temporary)
    os.replace(temporary, target)
    fault_point("named", target)


def output_folder(path: str | os.PathLike[str]) -> Path:
    """Make a folder, parents included, and return it.

    Raises:
        BadInput: a file stands in the way.
        CannotWrite: it cannot be made there.
    """
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError) as error:
        raise BadInput(
            f"'{folder}' is a file, or lies below one", "a folder, new or existing", "choose another place"
        ) from error
    except OSError as error:
        raise CannotWrite(f"cannot make '{folder}' ({error.strerror})", "a writable place", "choose another") from error
    return folder


def drop_unfinished(folder: str | os.PathLike[str]) -> list[Path]:
    """Remove what killed processes of this machine were writing anywhere below ``folder``; return what it was.

    Files of processes that live, and of other machines that share the folder, stay.
    """
    dropped = []
    for place, _, names in os.walk(folder):
        for name in names:
            found = re.search(rf"~{_machine()}-(\d+)~", name) if name.startswith(".") else None
            if found and not _lives(int(found[1])):
                dropped.append(Path(place, name))
                dropped[-1].unlink(missing_ok=True)
    return dropped


def _owner() -> str:
    """Part of an unfinished file's name: which process of which machine is writing it."""
    return f"~{_machine()}-{os.getpid()}~"


@cache
def _machine() -> str:
    return hashlib.sha256(platform.node().encode()).hexdigest()[:6]


def _lives(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # somebody else's
        return True
    return True


def _cannot_write(target: Path, error: Exception) -> CannotWrite:
    why = getattr(error, "strerror", None) or str(error)
    return CannotWrite(
        f"cannot write '{target}' ({why})",
        "a writable folder with room",
        "make room, or choose another place; what was finished is kept, the same command goes on from there",
    )
