"""Unpacks zip and tar archives that somebody else made: plain files only, inside one folder, of a bounded size."""

from __future__ import annotations

import gzip
import lzma
import stat
import struct
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO

from orca.atomic import atomic_path
from orca.errors import BadInput

__all__ = ["MAX_MEMBERS", "unpack"]

MAX_MEMBERS = 100_000
_CHUNK = 1 << 20
_BROKEN = (  # what the modules raise on nonsense
    *(zipfile.BadZipFile, tarfile.TarError, zlib.error, lzma.LZMAError, gzip.BadGzipFile, EOFError),
    *(NotImplementedError, RuntimeError, ValueError, IndexError, struct.error),
)


@dataclass(frozen=True)
class _Member:
    name: str
    size: int
    open: Callable[[], IO[bytes]]


def unpack(
    archive: Path,
    folder: Path,
    max_bytes: int,
    wanted: Callable[[str], bool] = lambda name: True,
) -> list[Path]:
    """Unpack an archive; return the files written, in its order.

    Every member is checked before the first is written, so a refused archive leaves nothing behind. Each file appears
    whole or not at all. Rights, owners and times of the archive are ignored.

    Args:
        archive: a .zip, or a .tar with any compression that Python reads.
        folder: where to.
        max_bytes: of all files together.
        wanted: says which names to write; the others are checked too.

    Raises:
        BadInput: not an archive, damaged, too large, two members of one name, or one that is a link, a device, or
            would lie outside the folder (named).
    """
    try:
        if zipfile.is_zipfile(archive):
            with zipfile.ZipFile(archive) as opened:
                return _write(archive, _zip_members(archive, opened), folder, max_bytes, wanted)
        with tarfile.open(archive) as tar:
            return _write(archive, _tar_members(archive, tar), folder, max_bytes, wanted)
    except _BROKEN as error:
        if isinstance(error, BadInput):
            raise
        raise BadInput(f"{archive} is no archive, or damaged ({error})", "a zip or tar", "fetch it again") from error


def _write(
    archive: Path, members: Iterator[_Member], folder: Path, max_bytes: int, wanted: Callable[[str], bool]
) -> list[Path]:
    checked: dict[str, _Member] = {}
    total = 0
    for member in members:
        total += member.size
        if len(checked) >= MAX_MEMBERS or total > max_bytes:
            raise _refused(archive, f"more than {MAX_MEMBERS} files or {max_bytes} bytes")
        key = member.name.casefold()  # on some file systems A and a are one file
        if key in checked:
            raise _refused(archive, f"two members named '{member.name}'")
        checked[key] = member
    written = []
    for member in checked.values():
        if wanted(member.name):
            written.append(folder / member.name)
            _copy(archive, member, folder, written[-1])
    return written


def _copy(archive: Path, member: _Member, folder: Path, target: Path) -> None:
    if not target.parent.resolve().is_relative_to(folder.resolve()):  # a link that was in the folder before
        raise _refused(archive, f"'{member.name}', which a link in {folder} leads elsewhere")
    with atomic_path(target) as temporary, temporary.open("wb") as file:
        copied = 0
        for chunk in _chunks(archive, member):
            copied += len(chunk)
            if copied > member.size:
                raise _refused(archive, f"'{member.name}', which is larger than it says")
            file.write(chunk)
        if copied != member.size:
            raise _refused(archive, f"'{member.name}', which ends early")


def _chunks(archive: Path, member: _Member) -> Iterator[bytes]:
    """The content of a member. A damaged archive also leads the modules to seek to nonsense, which is an OSError."""
    try:
        with member.open() as source:
            while chunk := source.read(_CHUNK):
                yield chunk
    except OSError as error:
        raise BadInput(
            f"'{member.name}' of {archive} cannot be read ({error})", "a whole archive", "fetch it again"
        ) from error


def _zip_members(archive: Path, opened: zipfile.ZipFile) -> Iterator[_Member]:
    for info in opened.infolist():
        kind = stat.S_IFMT(info.external_attr >> 16)
        if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
            raise _refused(archive, f"'{info.filename}', a link or device")
        if info.flag_bits & 1:
            raise _refused(archive, f"'{info.filename}', which is encrypted")
        name = _safe_name(archive, info.orig_filename.rstrip("/") if info.is_dir() else info.orig_filename)
        if not info.is_dir():
            yield _Member(name, info.file_size, lambda info=info: opened.open(info))  # type: ignore[misc]


def _tar_members(archive: Path, tar: tarfile.TarFile) -> Iterator[_Member]:
    for info in tar:
        if not (info.isreg() or info.isdir()) or info.issparse():
            raise _refused(archive, f"'{info.name}', a link, device or sparse file")
        name = _safe_name(archive, info.name)
        if info.isreg():
            yield _Member(name, info.size, lambda info=info: _tar_file(tar, info))  # type: ignore[misc]


def _tar_file(tar: tarfile.TarFile, info: tarfile.TarInfo) -> IO[bytes]:
    file = tar.extractfile(info)
    if file is None:
        raise tarfile.ReadError(f"'{info.name}' cannot be read")
    return file


def _safe_name(archive: Path, name: str) -> str:
    """A relative name without any way out; raises `BadInput` for any other."""
    path = PurePosixPath(name)
    plain = name and "\\" not in name and ":" not in name and "\0" not in name and not path.is_absolute()
    if not plain or any(part in ("..", "") for part in path.parts) or len(name) > 1000 or path == PurePosixPath("."):
        raise _refused(archive, f"the name {name[:200]!r}")
    return path.as_posix()


def _refused(archive: Path, what: str) -> BadInput:
    return BadInput(
        f"archive {archive} holds {what}", "plain files inside one folder", "do not unpack it: fetch it again"
    )
