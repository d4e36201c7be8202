"""No-reference scores: one number a frame, their mean a scene."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from bench.metrics.metric import Score
from orca.conventions import UInt8Array

__all__ = ["mean_over_frames"]


def mean_over_frames(frames: UInt8Array, score: Callable[[UInt8Array], float | None], no_value: str) -> Score:
    """Score each frame, equal frames once, and average those that have a value.

    Args:
        frames: [n, H, W, 3] uint8.
        score: value of one frame [H, W, 3]; None or not finite when it has none.
        no_value: why a frame may have no value, for the reader.
    """
    known: dict[bytes, float | None] = {}
    values: list[float | None] = []
    for frame in frames:
        key = hashlib.sha256(np.ascontiguousarray(frame).tobytes()).digest()
        if key not in known:
            value = score(frame)
            known[key] = None if value is None or not math.isfinite(value) else float(value)
        values.append(known[key])
    kept = [x for x in values if x is not None]
    detail: dict[str, Any] = {"distinct_frames": len(known), "frames_without_value": len(values) - len(kept)}
    if len(kept) < len(values):
        detail["why_without_value"] = no_value
    if not kept:
        return Score(None, 0, no_value if values else "no frames", tuple(values), detail)
    return Score(float(np.mean(kept)), len(kept), None, tuple(values), detail)
