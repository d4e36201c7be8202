"""Arrays from PNG and NPY files that somebody else wrote: sizes are checked before anything is allocated."""

from __future__ import annotations

import math
import struct
import tokenize
from pathlib import Path
from typing import Any, BinaryIO

import cv2
import numpy as np
from numpy.typing import NDArray

from orca.errors import BadInput

__all__ = ["MAX_VALUES", "decode_png", "read_npy", "read_png"]

MAX_VALUES = 400_000_000  # four channels of the largest image that is read
MAX_BYTES = 4 * 2**30
# What numpy raises on nonsense: it reads the header with Python's own tokenizer and parser.
_BROKEN = (
    *(OSError, ValueError, TypeError, KeyError, EOFError, OverflowError, SyntaxError, MemoryError, RecursionError),
    tokenize.TokenError,
)
_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def read_png(path: Path) -> NDArray[np.generic]:
    """The stored values of a PNG of 8 or 16 bits, [H, W] or [H, W, C] (OpenCV's order of channels).

    Raises:
        BadInput: no such file, another format, damaged, or larger than `MAX_VALUES`.
    """
    return decode_png(_content(path, "a PNG, 8 or 16 bits"), f"'{path}'")


def decode_png(content: bytes, what: str) -> NDArray[np.generic]:
    """As `read_png`, from memory; ``what`` names it in the error."""
    if not content.startswith(_SIGNATURE) or len(content) < 33:
        raise BadInput(f"{what} is not a PNG", "PNG, 8 or 16 bits", "get the file again")
    width, height = struct.unpack(">II", content[16:24])
    if not 0 < width * height <= MAX_VALUES // 4:
        raise BadInput(f"{what} of {width}x{height} pixels", f"at most {MAX_VALUES // 4} pixels", "scale it down")
    if (problem := _broken_chunks(content)) is not None:
        raise BadInput(f"{what} {problem}", "a whole PNG, 8 or 16 bits, no animation", "get the file again")
    try:
        values = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise BadInput(f"{what} cannot be decoded ({error.err})", "a whole PNG", "get the file again") from error
    if values is None:
        raise BadInput(f"{what} is not a readable PNG", "a whole PNG, 8 or 16 bits", "get the file again")
    return np.asarray(values)


def _broken_chunks(content: bytes) -> str | None:
    """What is wrong with how a PNG is divided, if anything is. OpenCV 5 allocates what a chunk claims, up to 4 GB."""
    at, kinds = len(_SIGNATURE), list[bytes]()
    while kinds[-1:] != [b"IEND"]:
        if at + 12 > len(content):
            return "ends before it is whole"
        (size,), kind = struct.unpack(">I", content[at : at + 4]), content[at + 4 : at + 8]
        at += 12 + size  # length, kind, content, checksum
        if at > len(content):
            return f"has a part that claims {size} bytes"
        kinds.append(kind)
    if kinds[0] != b"IHDR" or kinds.count(b"IHDR") > 1:
        return "has no single header"
    return "is an animation" if b"acTL" in kinds else None


def read_npy(path: Path) -> NDArray[np.generic]:
    """The real numbers of an NPY file. The shape that its header claims must be there, byte for byte.

    Raises:
        BadInput: no such file, not an array of real numbers, fewer bytes than its shape asks for, or larger than
            `MAX_VALUES`.
    """
    allowed = "an NPY file of real numbers"
    try:
        with path.open("rb") as file:
            count, dtype = _claimed(file)
            if count > MAX_VALUES:
                raise BadInput(f"'{path}' of {count} values", f"at most {MAX_VALUES}", "scale it down")
            if dtype.kind not in "fiu":
                raise BadInput(f"'{path}' holds no numbers, but {dtype}", allowed, "save it with np.save")
            have = path.stat().st_size - file.tell()
            if have < count * dtype.itemsize:
                raise BadInput(f"'{path}' of {have} bytes for {count} values of {dtype}", allowed, "get it again")
            file.seek(0)
            return np.asarray(np.lib.format.read_array(file, allow_pickle=False))
    except BadInput:
        raise
    except _BROKEN as error:
        raise BadInput(f"'{path}' is not a readable NPY ({error})", allowed, "save it with np.save") from error


def _claimed(file: BinaryIO) -> tuple[int, np.dtype[Any]]:
    """How many values of which type the header of an NPY file promises; nothing else is read."""
    version = np.lib.format.read_magic(file)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"version {version}")
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(file)
    if len(shape) > 8 or min(shape, default=0) < 0:
        raise ValueError(f"shape {shape}")
    return math.prod(shape), dtype


def _content(path: Path, allowed: str) -> bytes:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise BadInput(f"'{path}' of {path.stat().st_size} bytes", f"at most {MAX_BYTES}", "scale it down")
        return path.read_bytes()
    except OSError as error:
        raise BadInput(f"'{path}' cannot be read ({error.strerror})", allowed, "check the path") from error
