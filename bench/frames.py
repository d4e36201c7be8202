"""The scored frames of a cell at rest: lossless, so that a new metric needs no new run of the method."""

from __future__ import annotations

import hashlib
import io
import logging
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.adapters.adapter import MethodOutput
from bench.record import CellRecord, StoredFrame
from bench.store import write_atomic
from orca.array_file import decode_png
from orca.conventions import Float32Array, UInt8Array, to_float, to_uint8

__all__ = ["frame_hashes", "load_frames", "save_frames", "stored_precision"]

_log = logging.getLogger(__name__)

# What numpy, its zip reader and OpenCV raise on nonsense.
_BROKEN = (
    *(OSError, ValueError, KeyError, TypeError, AttributeError, EOFError, IndexError, OverflowError, MemoryError),
    *(zipfile.BadZipFile, zlib.error, RuntimeError, SyntaxError, tokenize.TokenError, struct.error, cv2.error),
)

# One filter for all rows. Measured on 512x512 renders: 16 ms and 0.39 MB a frame, 8 ms and 0.09 MB a depth; trying
# every filter on every row took 29 and 25 ms for 0.36 and 0.09 MB.
_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_SUB]
_COLOUR_PNG = [*_PNG, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY]
_DEPTH_PNG = [*_PNG, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE]


def frame_hashes(frames: UInt8Array, indices: Sequence[int]) -> tuple[StoredFrame, ...]:
    """SHA-256 of the pixels of each frame ([n, H, W, 3] uint8, row-major RGB), with its index in the trajectory."""
    return tuple(
        StoredFrame(int(index), hashlib.sha256(np.ascontiguousarray(frame).tobytes()).hexdigest())
        for index, frame in zip(indices, frames, strict=True)
    )


def stored_precision(output: MethodOutput) -> MethodOutput:
    """The output with its coverage in 1/255 steps and its frames' depth in float16, as they are stored.

    Metrics see this one, fresh or reloaded: a score does not depend on when it was computed.
    """

    def rounded(coverage: Float32Array) -> Float32Array:
        return to_float(to_uint8(coverage))

    views = output.true_view_coverage
    return replace(
        output,
        coverage=None if output.coverage is None else rounded(output.coverage),
        true_view_coverage=None if views is None else tuple(rounded(view) for view in views),
        frame_depth=None
        if output.frame_depth is None
        else np.stack([_to_depth(_to_half(d)) for d in output.frame_depth]),
    )


def save_frames(path: Path, output: MethodOutput) -> None:
    """Write frames, coverage, input view and true views as PNG streams, depths raw, in one atomic ``.npz``."""
    images: dict[str, NDArray[Any]] = {f"frame_{i:06d}": f for i, f in enumerate(output.frames)}
    if output.coverage is not None:
        images |= {f"coverage_{i:06d}": to_uint8(c) for i, c in enumerate(output.coverage)}
    if output.input_view is not None:
        images["input_view"] = output.input_view
    if output.frame_depth is not None:
        images |= {f"depth_{i:06d}": _to_half(d) for i, d in enumerate(output.frame_depth)}
    if output.true_views is not None:
        images |= {f"trueview_{i:06d}": v for i, v in enumerate(output.true_views)}
    if output.true_view_coverage is not None:
        images |= {f"truecoverage_{i:06d}": to_uint8(c) for i, c in enumerate(output.true_view_coverage)}
    arrays = _encode_all(images)
    # An empty array tells "none asked for" from "cannot render there".
    there = ("true_views", "true_view_coverage", "true_view_depth")
    arrays |= {name: np.zeros(0, np.uint8) for name in there if getattr(output, name) is not None}
    depths: dict[str, Float32Array] = {}
    if output.true_view_depth is not None:
        depths = {f"truedepth_{i:06d}": d for i, d in enumerate(output.true_view_depth)}
    buffer = io.BytesIO()
    np.savez(buffer, **arrays, **depths)  # type: ignore[arg-type]
    write_atomic(path, buffer.getvalue())


def load_frames(path: Path, record: CellRecord) -> MethodOutput | None:
    """Read back what `save_frames` wrote for ``record``.

    Returns None, and logs why, when the file is gone, broken, or holds other pixels than the record names.
    """
    if not path.is_file():
        _log.warning("%s is gone: %s has to run again", path, record.method)
        return None
    try:
        with np.load(path, allow_pickle=False) as archive:
            _check_members(archive)
            output = _decode_all({key: _numbers(archive[key]) for key in archive.files}, record)
    except _BROKEN as error:
        _log.warning("%s cannot be read (%s): %s has to run again", path, error, record.method)
        return None
    indices = [frame.index for frame in record.frames]
    if len(output.frames) != len(indices) or frame_hashes(output.frames, indices) != record.frames:
        _log.warning("%s holds other pixels than its record: %s has to run again", path, record.method)
        return None
    return output


def _check_members(archive: Any) -> None:
    """`save_frames` compresses nothing, so that a file cannot hold more than its own size."""
    if not isinstance(archive, np.lib.npyio.NpzFile) or archive.zip is None:
        raise ValueError("no archive of arrays")
    if any(member.compress_type != zipfile.ZIP_STORED for member in archive.zip.infolist()):
        raise ValueError("compressed arrays")


def _numbers(array: NDArray[Any]) -> NDArray[Any]:
    """`save_frames` writes bytes and float32; converting text that is none can end in a `SystemError` of Python."""
    if array.dtype not in (np.uint8, np.float32):
        raise ValueError(f"an array of {array.dtype}")
    return array


def _decode_all(arrays: dict[str, NDArray[Any]], record: CellRecord) -> MethodOutput:
    def series(prefix: str) -> list[NDArray[Any]]:
        return [_decode(arrays[key]) for key in sorted(arrays) if key.startswith(prefix + "_")]

    coverage, depth = series("coverage"), series("depth")
    return MethodOutput(
        frames=np.stack(series("frame")),
        coverage=np.stack([to_float(c) for c in coverage]) if coverage else None,
        input_view=_decode(arrays["input_view"]) if "input_view" in arrays else None,
        true_views=tuple(series("trueview")) if "true_views" in arrays else None,
        true_view_coverage=(
            tuple(to_float(c) for c in series("truecoverage")) if "true_view_coverage" in arrays else None
        ),
        true_view_depth=(
            tuple(arrays[key] for key in sorted(arrays) if key.startswith("truedepth_"))
            if "true_view_depth" in arrays
            else None
        ),
        frame_depth=np.stack([_to_depth(bits) for bits in depth]) if depth else None,
        timing=_timing(record),
        model=dict(record.model),
        notes=record.notes,
    )


def _timing(record: CellRecord) -> dict[str, float]:
    seconds: dict[str, float] = dict(record.timing.get("phases", {}))
    if (render := record.timing.get("render_ms_per_frame")) is not None:
        seconds["render_ms_per_frame"] = render
    return seconds


def _to_half(depth: Float32Array) -> NDArray[np.uint16]:
    """The bits of the depth in float16, which grow with it: 0 where there is none."""
    known = np.isfinite(depth) & (depth > 0)
    half = np.where(known, np.minimum(depth, np.finfo(np.float16).max), 0).astype(np.float16)
    return half.view(np.uint16)


def _to_depth(bits: NDArray[np.uint16]) -> Float32Array:
    return np.ascontiguousarray(bits).view(np.float16).astype(np.float32)


def _encode_all(images: dict[str, NDArray[Any]]) -> dict[str, NDArray[np.uint8]]:
    from orca.threads import map_on_cores  # loads torch

    return dict(zip(images, map_on_cores(_encode, images.values()), strict=True))


def _encode(image: NDArray[Any]) -> NDArray[np.uint8]:
    settings = _COLOUR_PNG if image.ndim == 3 else _DEPTH_PNG
    pixels = image[..., ::-1] if image.ndim == 3 else image
    done, stream = cv2.imencode(".png", np.ascontiguousarray(pixels), settings)
    if not done:
        raise ValueError(f"OpenCV could not encode an image of shape {image.shape}")
    return np.asarray(stream, np.uint8).ravel()


def _decode(stream: NDArray[np.uint8]) -> NDArray[Any]:
    image = decode_png(np.asarray(stream, np.uint8).tobytes(), "a stored frame")
    return np.ascontiguousarray(image[..., ::-1] if image.ndim == 3 else image)
