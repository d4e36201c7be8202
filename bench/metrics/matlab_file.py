"""Reads matrices of numbers from a MATLAB 5 file, in Python only: scipy's reader dies of broken files (signal 11).

The format is MATLAB's own description of its "Level 5 MAT-file".
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Collection, Iterator
from pathlib import Path

import numpy as np

from orca.conventions import Float64Array
from orca.errors import BadInput

__all__ = ["MAX_BYTES", "read_matrices"]

MAX_BYTES = 1 << 20  # of the file, and of each compressed part of it
_HEADER, _TAG = 128, 8
_MATRIX, _COMPRESSED = 14, 15
_DTYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_FULL = range(6, 16)  # classes of arrays that are full and numeric
_COMPLEX = 0x800
_ALLOWED = "a MATLAB file of version 5 to 7.2, little endian, at most 1 MiB"


def read_matrices(path: Path, names: Collection[str]) -> dict[str, Float64Array]:
    """The real, full, numeric arrays of a file that have one of these names; what else it holds is left aside.

    Args:
        path: the file.
        names: of the variables.

    Returns:
        Name -> array in the shape that the file states, float64. A name that the file lacks is not there.

    Raises:
        BadInput: no such file, or it is damaged or too large.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise ValueError(f"{path.stat().st_size} bytes")
        content = path.read_bytes()
        if len(content) < _HEADER or content[124:_HEADER] != b"\0\1IM":
            raise ValueError("no header of such a file")
        arrays = (array for kind, body in _elements(content[_HEADER:]) for array in _matrices(kind, body))
        return {name: array for name, array in arrays if name in names}
    except (OSError, ValueError, zlib.error) as error:
        raise BadInput(f"{path} cannot be read ({error})", _ALLOWED, "copy the file again") from error


def _elements(content: bytes) -> Iterator[tuple[int, bytes]]:
    """(type, body) of each element; a body ends within the content."""
    at = 0
    while at < len(content):
        if at + _TAG > len(content):
            raise ValueError("ends early")
        kind, size = struct.unpack_from("<II", content, at)
        start = at + _TAG
        if kind >> 16:  # a small one: its size lies in its type, its body in the four bytes after
            kind, size, start = kind & 0xFFFF, kind >> 16, at + 4
            if size > 4:
                raise ValueError(f"a small element of {size} bytes")
        if size > len(content) - start:
            raise ValueError(f"{size} bytes claimed, {len(content) - start} are there")
        yield kind, content[start : start + size]
        end = start + size
        at = end if kind == _COMPRESSED else end + -end % _TAG


def _matrices(kind: int, body: bytes) -> Iterator[tuple[str, Float64Array]]:
    """The array of an element that is one, compressed or not."""
    if kind == _COMPRESSED:
        unpacking = zlib.decompressobj()
        body = unpacking.decompress(body, MAX_BYTES)
        if unpacking.unconsumed_tail:
            raise ValueError(f"a compressed part of more than {MAX_BYTES} bytes")
        ((kind, body),) = _one(body)
    if kind == _MATRIX:
        found = _matrix(body)
        if found is not None:
            yield found


def _one(content: bytes) -> list[tuple[int, bytes]]:
    elements = list(_elements(content))
    if len(elements) != 1:
        raise ValueError(f"{len(elements)} elements in a compressed part")
    return elements


def _matrix(body: bytes) -> tuple[str, Float64Array] | None:
    """Name and values; None for text, cells, sparse and complex arrays."""
    parts = _elements(body)
    (_, flags), (_, shape), (_, name) = _next(parts), _next(parts), _next(parts)
    if len(flags) != 8 or len(shape) % 4 or not 8 <= len(shape) <= 32:
        raise ValueError("a broken array")
    (word,) = struct.unpack_from("<I", flags)
    if word & 0xFF not in _FULL or word & _COMPLEX:
        return None
    dims = [int(n) for n in np.frombuffer(shape, "<i4")]
    kind, values = _next(parts)
    if kind not in _DTYPES or min(dims) < 0:
        raise ValueError(f"an array of type {kind} and shape {dims}")
    dtype = np.dtype(_DTYPES[kind]).newbyteorder("<")
    if math.prod(dims) * dtype.itemsize != len(values):
        raise ValueError(f"{len(values)} bytes for shape {dims}")
    return name.decode("latin-1"), np.frombuffer(values, dtype).reshape(dims, order="F").astype(np.float64)


def _next(parts: Iterator[tuple[int, bytes]]) -> tuple[int, bytes]:
    found = next(parts, None)
    if found is None:
        raise ValueError("an array ends early")
    return found
