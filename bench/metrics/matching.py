"""Mutual nearest neighbours with a ratio test on angles, as COLMAP matches descriptors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orca.conventions import Float32Array, Float64Array

__all__ = ["MatchConfig", "match_descriptors"]

IndexArray = NDArray[np.intp]

# Rows of the similarity matrix held at a time: a few megabytes, so that it stays in cache.
BLOCK_ROWS = 256
# arccos turns the last bit of a float32 cosine near 1 into 5e-4 rad: below this, angles are equal (a tie fails).
ANGLE_RESOLUTION = 1e-3


@dataclass(frozen=True)
class MatchConfig:
    """The reference's matcher.

    Attributes:
        ratio: the best angle must be below this times the second best, in both directions.
        max_angle: largest angle between matched descriptors, radians.
    """

    ratio: float = 0.8
    max_angle: float = 0.7


def match_descriptors(
    first: Float32Array, second: Float32Array, config: MatchConfig | None = None
) -> tuple[IndexArray, IndexArray]:
    """Indices (i, j) of the matches of two sets of unit descriptors, ordered by i.

    A match is the nearest neighbour in both directions, within ``max_angle``, and passes the ratio test in both
    directions; angles are arccos of the dot product. Exact ties fail. Where one side has a single descriptor there is
    no second best, and the ratio test passes, as in the reference.

    Args:
        first: [n, d] float32, unit rows.
        second: [m, d] float32, unit rows.
        config: thresholds; the reference's when left out.
    """
    c = config or MatchConfig()
    if len(first) == 0 or len(second) == 0:
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
    nearest, best, runner_up, column_best = _scan_rows(first, second)
    # The mutual test comes first: it leaves few columns of which the second best must be known.
    kept = column_best[nearest] == best
    kept &= _angle(best) <= c.max_angle
    kept &= _passes_ratio(best, runner_up, c.ratio)
    i = np.flatnonzero(kept)
    j = nearest[i]
    passed = _passes_ratio(best[i], _column_runner_up(first, second, i, j), c.ratio)
    return i[passed], j[passed]


def _scan_rows(
    first: Float32Array, second: Float32Array
) -> tuple[IndexArray, Float32Array, Float32Array, Float32Array]:
    """Per row of first @ second.T: argmax, max, second largest; per column: max."""
    n, m = len(first), len(second)
    nearest = np.empty(n, np.intp)
    best, runner_up = np.empty(n, np.float32), np.empty(n, np.float32)
    column_best = np.full(m, -np.inf, np.float32)
    buffer = np.empty((min(BLOCK_ROWS, n), m), np.float32)
    for start in range(0, n, BLOCK_ROWS):
        rows = slice(start, min(start + BLOCK_ROWS, n))
        similarity = np.matmul(first[rows], second.T, out=buffer[: rows.stop - start])
        np.maximum(column_best, similarity.max(axis=0), out=column_best)
        nearest[rows] = similarity.argmax(axis=1)
        here = np.arange(len(similarity)), nearest[rows]
        best[rows] = similarity[here]
        similarity[here] = -np.inf
        runner_up[rows] = similarity.max(axis=1)
    return nearest, best, runner_up, column_best


def _column_runner_up(first: Float32Array, second: Float32Array, i: IndexArray, j: IndexArray) -> Float32Array:
    """Largest similarity of descriptor j of ``second`` to any of ``first`` but i, for each pair (i, j)."""
    result = np.empty(len(j), np.float32)
    for start in range(0, len(j), BLOCK_ROWS):
        rows = slice(start, min(start + BLOCK_ROWS, len(j)))
        similarity = second[j[rows]] @ first.T
        similarity[np.arange(len(similarity)), i[rows]] = -np.inf
        result[rows] = similarity.max(axis=1)
    return result


def _angle(similarity: Float32Array) -> Float64Array:
    return np.arccos(np.clip(similarity.astype(np.float64), -1.0, 1.0))


def _passes_ratio(best: Float32Array, runner_up: Float32Array, ratio: float) -> NDArray[np.bool_]:
    """Ratio test on angles; a second best of -inf (there is none) always passes."""
    nearest = np.maximum(_angle(best), ANGLE_RESOLUTION)
    second = np.maximum(_angle(runner_up), ANGLE_RESOLUTION)
    return (nearest < ratio * second) | np.isneginf(runner_up)
