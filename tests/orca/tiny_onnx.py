"""A one-layer ONNX network, written byte by byte: a 1x1 convolution with given channel weights."""

from __future__ import annotations

import struct
from pathlib import Path

__all__ = ["write_channel_mixer"]


def _varint(value: int) -> bytes:
    out = b""
    while value > 127:
        out, value = out + bytes([value & 127 | 128]), value >> 7
    return out + bytes([value])


def _number(field: int, value: int) -> bytes:
    return _varint(field << 3) + _varint(value)


def _bytes(field: int, content: bytes | str) -> bytes:
    raw = content.encode() if isinstance(content, str) else content
    return _varint(field << 3 | 2) + _varint(len(raw)) + raw


def _value(name: str, shape: tuple[int, ...]) -> bytes:
    dims = b"".join(_bytes(1, _number(1, d)) for d in shape)
    return _bytes(1, name) + _bytes(2, _bytes(1, _number(1, 1) + _bytes(2, dims)))


def write_channel_mixer(path: Path, weights: tuple[float, float, float], size: int = 8) -> None:
    """output[y, x] = sum_c weights[c] input[c, y, x], for an input of [1, 3, size, size]."""
    tensor = b"".join(_number(1, d) for d in (1, 3, 1, 1))
    tensor += _number(2, 1) + _bytes(8, "w") + _bytes(9, struct.pack("<3f", *weights))
    node = _bytes(1, "x") + _bytes(1, "w") + _bytes(2, "y") + _bytes(3, "mix") + _bytes(4, "Conv")
    graph = _bytes(1, node) + _bytes(2, "g") + _bytes(5, tensor)
    graph += _bytes(11, _value("x", (1, 3, size, size))) + _bytes(12, _value("y", (1, 1, size, size)))
    path.write_bytes(_number(1, 7) + _bytes(7, graph) + _bytes(8, _bytes(1, "") + _number(2, 11)))
