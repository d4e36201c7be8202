"""No-reference scores: one number a frame, their mean a scene."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from bench.metrics.metric import Score
from orca.conventions import UInt8Array
from orca.errors import BadInput

__all__ = [
    "Each",
    "FrameScore",
    "check_frames",
    "distinct_frames",
    "frame_sha256",
    "mean_of_values",
    "mean_over_frames",
]

FrameScore = Callable[[UInt8Array], float | None]
Each = Callable[[FrameScore, list[UInt8Array]], Iterable[float | None]]


def mean_over_frames(
    frames: UInt8Array,
    score: FrameScore,
    no_value: str,
    each: Each = map,
) -> Score:
    """Score each frame, equal frames once, and average those that have a value.

    Args:
        frames: [n, H, W, 3] uint8.
        score: value of one frame [H, W, 3]; None or not finite when it has none.
        no_value: why a frame may have no value, for the reader.
        each: how the distinct frames are gone through, in order (`map`, or that of a pool of threads).
    """
    distinct, which = distinct_frames(frames)
    found = list(each(score, distinct))
    return mean_of_values([found[k] for k in which], no_value, len(distinct))


def mean_of_values(found: Sequence[float | None], no_value: str, distinct: int) -> Score:
    """The mean of the values that are there and finite; ``distinct`` says how many frames differ."""
    values = [None if x is None or not math.isfinite(x) else float(x) for x in found]
    kept = [x for x in values if x is not None]
    detail: dict[str, Any] = {"distinct_frames": distinct, "frames_without_value": len(values) - len(kept)}
    if len(kept) < len(values):
        detail["why_without_value"] = no_value
    if not kept:
        return Score(None, 0, no_value if values else "no frames", tuple(values), detail)
    return Score(float(np.mean(kept)), len(kept), None, tuple(values), detail)


def distinct_frames(frames: UInt8Array) -> tuple[list[UInt8Array], list[int]]:
    """The frames that differ, by the hash of their pixels, and for each frame which of those it is."""
    known: dict[str, int] = {}
    distinct: list[UInt8Array] = []
    which: list[int] = []
    for frame in frames:
        key = frame_sha256(frame)
        if key not in known:
            known[key] = len(distinct)
            distinct.append(frame)
        which.append(known[key])
    return distinct, which


def frame_sha256(frame: UInt8Array) -> str:
    """Hash of a frame's size and pixels."""
    return hashlib.sha256(f"{frame.shape}".encode() + np.ascontiguousarray(frame).tobytes()).hexdigest()


def check_frames(frames: UInt8Array) -> None:
    """Raise `BadInput` unless ``frames`` is [n, H, W, 3] uint8 with at least one pixel a frame (n may be 0)."""
    if frames.ndim == 4 and frames.shape[3] == 3 and 0 not in frames.shape[1:3] and frames.dtype == np.uint8:
        return
    raise BadInput(
        f"frames of shape {frames.shape} and type {frames.dtype}",
        "an array [n, H, W, 3] of type uint8 (RGB)",
        "clip and round the frames to 0..255, and give grey ones three equal channels",
    )
