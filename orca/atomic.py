"""Files appear whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from orca.errors import BadInput

__all__ = ["atomic_path", "output_folder"]


@contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path in the same folder; it takes the name ``path`` only if the block succeeds.

    The suffix is kept, for writers that choose the format by it. Missing folders are created.

    Raises:
        BadInput: ``path`` is a folder, or its folder cannot be made or written.
    """
    target = Path(path)
    if target.is_dir():
        raise BadInput(f"'{target}' is a folder", "a file name", "add a file name to the path")
    output_folder(target.parent)
    try:
        handle, name = tempfile.mkstemp(prefix=f".{target.stem}-", suffix=target.suffix, dir=target.parent)
    except OSError as error:
        raise BadInput(f"cannot write '{target}' ({error.strerror})", "a writable folder", "choose another") from error
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)  # mkstemp makes files private; an ordinary file follows the umask
        os.replace(temporary, target)
    finally:
        temporary.unlink(missing_ok=True)


def output_folder(path: str | os.PathLike[str]) -> Path:
    """Make a folder, parents included, and return it; raises `BadInput` where a file stands in the way."""
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError) as error:
        raise BadInput(
            f"'{folder}' is a file, or lies below one", "a folder, new or existing", "choose another place"
        ) from error
    except OSError as error:
        raise BadInput(f"cannot make '{folder}' ({error.strerror})", "a writable place", "choose another") from error
    return folder
