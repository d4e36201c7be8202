"""Which patches of an image look like another one: costs up to an offset, of whole stretches of a row at once."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from orca.conventions import Float32Array

__all__ = ["MOST_CANDIDATES", "SPAN", "compare", "lowest", "make_spans", "short_list"]

MOST_CANDIDATES = 12288  # of the whole patches; a random part keeps every phase of a pattern many times over
SPAN = 64  # pixels along a row whose patches are compared at once: the processor works on many in one instruction
_MUCH = np.float32(3e38)  # no infinity: fast arithmetic does without


def make_spans(candidates: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First and past-the-end index of each span's candidates, [spans, 2], and the candidates of all spans.

    A span is at most `SPAN` pixels long. Of too many candidates random spans are kept, in order.
    """
    spans = []
    first = 0
    while first < len(candidates):
        end = int(np.searchsorted(candidates, candidates[first] + SPAN))
        spans.append((first, end))
        first = end
    bounds = np.asarray(spans, np.int64)
    if len(candidates) > MOST_CANDIDATES:
        count = -(-len(bounds) * MOST_CANDIDATES // len(candidates))
        bounds = bounds[np.sort(np.random.default_rng(0).choice(len(bounds), count, replace=False))]
        candidates = np.concatenate([candidates[first:end] for first, end in bounds])
        ends = np.cumsum(bounds[:, 1] - bounds[:, 0])
        bounds = np.stack([np.concatenate([[0], ends[:-1]]), ends], 1)
    return bounds, candidates


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def lowest(cost: Float32Array, n: int) -> NDArray[np.int64]:
    """Indices of the ``n`` lowest costs, the lowest first; of equal ones the first."""
    order, filled = np.empty(n, np.int64), 0
    for i in range(len(cost)):
        if filled == n and cost[i] >= cost[order[n - 1]]:
            continue
        j = min(filled, n - 1)
        while j > 0 and cost[order[j - 1]] > cost[i]:
            order[j] = order[j - 1]
            j -= 1
        order[j] = i
        filled = min(filled + 1, n)
    return order


@numba.njit(cache=True, nogil=True, fastmath=True)  # type: ignore[untyped-decorator]
def short_list(
    pixels: Float32Array,
    candidates: NDArray[np.int64],
    spans: NDArray[np.int64],
    centre: int,
    shifts: NDArray[np.int64],
    offset_weight: float,
    n: int,
) -> NDArray[np.int64]:
    """The ``n`` candidates with the lowest cost (see `compare`), the lowest first; of equal ones the first."""
    here = np.empty((len(shifts), 4), np.float32)
    for j in range(len(shifts)):
        for c in range(4):
            here[j, c] = pixels[c, centre + shifts[j]]
    sums, cost = np.empty((4, SPAN), np.float32), np.empty(SPAN, np.float32)
    least, found, filled = np.full(n, _MUCH), np.empty(n, np.int64), 0
    for span in range(len(spans)):
        start = candidates[spans[span, 0]]
        _compare_span(
            pixels, start, candidates[spans[span, 1] - 1] - start + 1, here, shifts, offset_weight, sums, cost
        )
        for k in range(spans[span, 0], spans[span, 1]):
            value = cost[candidates[k] - start]
            if value < least[n - 1]:
                i = n - 1
                while i > 0 and least[i - 1] > value:
                    least[i], found[i] = least[i - 1], found[i - 1]
                    i -= 1
                least[i], found[i] = value, candidates[k]
                filled = min(filled + 1, n)
    return found[:filled]


@numba.njit(cache=True, nogil=True, fastmath=True)  # type: ignore[untyped-decorator]
def _compare_span(
    pixels: Float32Array,
    start: int,
    length: int,
    here: Float32Array,
    shifts: NDArray[np.int64],
    offset_weight: float,
    sums: Float32Array,
    cost: Float32Array,
) -> None:
    """Costs of the patches at ``length`` pixels on end into ``cost``; four pixels of a patch in one pass over them."""
    count, share, keep = len(shifts), np.float32(1.0 / len(shifts)), np.float32(1 - offset_weight)
    sums[:, :length], cost[:length] = 0, 0
    for j in range(0, count - 3, 4):
        p0, p1, p2, p3 = start + shifts[j], start + shifts[j + 1], start + shifts[j + 2], start + shifts[j + 3]
        for c in range(4):
            h0, h1, h2, h3 = here[j, c], here[j + 1, c], here[j + 2, c], here[j + 3, c]
            a0, a1 = pixels[c, p0 : p0 + length], pixels[c, p1 : p1 + length]
            a2, a3 = pixels[c, p2 : p2 + length], pixels[c, p3 : p3 + length]
            of_channel = sums[c]
            for i in range(length):
                d0, d1, d2, d3 = h0 - a0[i], h1 - a1[i], h2 - a2[i], h3 - a3[i]
                of_channel[i] += (d0 + d1) + (d2 + d3)
                cost[i] += (d0 * d0 + d1 * d1) + (d2 * d2 + d3 * d3)
    for j in range(count // 4 * 4, count):
        for c in range(4):
            p0, h0, of_channel = start + shifts[j], here[j, c], sums[c]
            for i in range(length):
                d0 = h0 - pixels[c, p0 + i]
                of_channel[i] += d0
                cost[i] += d0 * d0
    for i in range(length):
        s0, s1, s2, s3 = sums[0, i] * share, sums[1, i] * share, sums[2, i] * share, sums[3, i] * share
        cost[i] = cost[i] * share - keep * (s0 * s0 + s1 * s1 + s2 * s2) - s3 * s3


@numba.njit(cache=True, nogil=True, fastmath=True)  # type: ignore[untyped-decorator]
def compare(
    pixels: Float32Array, candidates: NDArray[np.int64], centre: int, shifts: NDArray[np.int64], offset_weight: float
) -> tuple[Float32Array, Float32Array]:
    """Cost of every candidate patch, [n], and the offset of colour and depth that brings it closest, [n, 4]."""
    count = np.float32(len(shifts))
    here = np.empty((len(shifts), 4), np.float32)
    for j in range(len(shifts)):
        for c in range(4):
            here[j, c] = pixels[c, centre + shifts[j]]
    cost, offset = np.empty(len(candidates), np.float32), np.empty((len(candidates), 4), np.float32)
    for k in range(len(candidates)):
        s0, s1, s2, s3 = np.float32(0), np.float32(0), np.float32(0), np.float32(0)
        squares = np.float32(0)
        for j in range(len(shifts)):
            p = candidates[k] + shifts[j]
            d0, d1 = here[j, 0] - pixels[0, p], here[j, 1] - pixels[1, p]
            d2, d3 = here[j, 2] - pixels[2, p], here[j, 3] - pixels[3, p]
            s0, s1, s2, s3 = s0 + d0, s1 + d1, s2 + d2, s3 + d3
            squares += d0 * d0 + d1 * d1 + d2 * d2 + d3 * d3
        s0, s1, s2, s3 = s0 / count, s1 / count, s2 / count, s3 / count
        offset[k, 0], offset[k, 1], offset[k, 2], offset[k, 3] = s0, s1, s2, s3
        # An offset of depth costs nothing: along a slope every place has another one.
        cost[k] = squares / count - (1 - offset_weight) * (s0 * s0 + s1 * s1 + s2 * s2) - s3 * s3
    return cost, offset
