"""Continue structure into a hole: stripes, tiles, edges and slopes by exemplars, averaged where nothing is predicted.

Exemplar-based inpainting (Criminisi et al. 2004) with three changes, all for fidelity and not for looks. A patch is
the weighted mean of its best matches and not the best one alone: where the matches agree, as on stripes, it is as
sharp as they are; where they do not, as on noise, it tends to the local mean, which is the best guess there is.
Matches are compared up to an offset that is then added, so that a gradient goes on. And depth comes along as a fourth
channel: a plane is linear in inverse depth, so a patch of it, shifted and offset, is the same plane continued.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from orca.conventions import Float32Array
from orca.repair.components import BoolArray

__all__ = ["ExemplarRules", "continue_structure"]

_MIN_CANDIDATES = 64
_FLAT = 1e-3  # priority of a patch without any structure; gradients count from here
_NOISE = 1e-4  # squared colour error that is rendering noise: matches this good are equally good
_MOST_CANDIDATES = 12288  # of the whole patches; a random part keeps every phase of a pattern many times over
_SHORT_LIST = 8  # so many times `matches` candidates are compared on every pixel, the others on every fourth


@dataclass(frozen=True)
class ExemplarRules:
    """How patches are compared.

    Attributes:
        radius: patches have 2 radius + 1 pixels a side.
        matches: how many of the best matches are averaged.
        offset_weight: a squared offset of colour counts this much against a squared difference of structure.
    """

    radius: int = 4
    matches: int = 12
    offset_weight: float = 0.5


def continue_structure(
    rgb: Float32Array, inverse_depth: Float32Array, source: BoolArray, hole: BoolArray, rules: ExemplarRules
) -> tuple[Float32Array, Float32Array, BoolArray] | None:
    """Colour and inverse depth of ``hole``, patch by patch from the source's side inwards.

    Args:
        rgb: colours, [h, w, 3]; read inside the source.
        inverse_depth: [h, w]; read inside the source.
        source: pixels that patches are taken from and that the hole is continued from, [h, w].
        hole: pixels to fill, [h, w]; what is in neither is foreground and takes no part.
        rules: patch size and averaging.

    Returns:
        Colours, inverse depth, and which pixels of the hole were filled (those that no path inside the hole joins to
        the source are not); None if the source holds too few whole patches to choose from.
    """
    side = 2 * rules.radius + 1
    whole = cv2.erode(
        source.astype(np.uint8), np.ones((side, side), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0
    )
    candidates = np.flatnonzero(whole).astype(np.int64)
    if len(candidates) < _MIN_CANDIDATES:
        return None
    if len(candidates) > _MOST_CANDIDATES:
        candidates = np.sort(np.random.default_rng(0).choice(candidates, _MOST_CANDIDATES, replace=False))
    scale = np.float32(1.0 / float(np.median(inverse_depth[source])))
    image = np.dstack([rgb, scale * inverse_depth]).astype(np.float32)
    image[~source] = 0.0
    # A padded frame, so that no patch reaches outside.
    radius = rules.radius
    pad = ((radius, radius), (radius, radius))
    padded = np.pad(image, (*pad, (0, 0)))
    known, inside = np.pad(source, pad), np.pad(hole, pad)
    strength = np.pad(_structure(rgb, source), pad)
    width = hole.shape[1]
    candidates = (candidates // width + radius) * (width + 2 * radius) + candidates % width + radius
    matches = min(rules.matches, len(candidates))
    _fill(padded, known, inside, strength, candidates, radius, matches, np.float32(rules.offset_weight))
    inner = np.s_[radius : radius + hole.shape[0], radius : radius + width]
    return padded[inner][..., :3], padded[inner][..., 3] / scale, np.asarray(known[inner] & hole)


def _structure(rgb: Float32Array, source: BoolArray) -> Float32Array:
    """Gradient magnitude inside the source, 0 elsewhere and at its border, [h, w]."""
    safe = np.where(source[..., None], rgb, np.float32(0.0)).astype(np.float32)
    dx, dy = cv2.Sobel(safe, cv2.CV_32F, 1, 0, scale=0.125), cv2.Sobel(safe, cv2.CV_32F, 0, 1, scale=0.125)
    inner = cv2.erode(source.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    return np.asarray(np.where(inner, np.sqrt((dx**2 + dy**2).sum(2)), 0.0), np.float32)


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _fill(
    image: Float32Array,
    known: BoolArray,
    hole: BoolArray,
    strength: Float32Array,
    candidates: NDArray[np.int64],
    radius: int,
    matches: int,
    offset_weight: float,
) -> None:
    """Patch after patch, the one with the highest priority first, until nothing of the hole touches the known."""
    height, width = hole.shape
    confidence = known.astype(np.float32)
    priority = np.full((height, width), np.float32(-1.0))
    for y in range(radius, height - radius):
        for x in range(radius, width - radius):
            priority[y, x] = _priority(known, hole, confidence, strength, y, x, radius)
    while True:
        best = np.argmax(priority)
        y, x = best // width, best % width
        if priority[y, x] < 0:
            return
        _paste(image, known, hole, confidence, candidates, y, x, radius, matches, offset_weight)
        reach = 2 * radius + 1
        for v in range(max(radius, y - reach), min(height - radius, y + reach + 1)):
            for u in range(max(radius, x - reach), min(width - radius, x + reach + 1)):
                priority[v, u] = _priority(known, hole, confidence, strength, v, u, radius)


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _priority(
    known: BoolArray, hole: BoolArray, confidence: Float32Array, strength: Float32Array, y: int, x: int, radius: int
) -> float:
    """Confidence times structure of a patch whose centre is the next to fill; -1 for any other pixel."""
    if not hole[y, x] or known[y, x]:
        return -1.0
    if not (known[y - 1, x] or known[y + 1, x] or known[y, x - 1] or known[y, x + 1]):
        return -1.0
    sure, structure = 0.0, 0.0
    for v in range(y - radius, y + radius + 1):
        for u in range(x - radius, x + radius + 1):
            sure += confidence[v, u]
            structure = max(structure, strength[v, u])
    return sure / (2 * radius + 1) ** 2 * (_FLAT + structure)


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _paste(
    image: Float32Array,
    known: BoolArray,
    hole: BoolArray,
    confidence: Float32Array,
    candidates: NDArray[np.int64],
    y: int,
    x: int,
    radius: int,
    matches: int,
    offset_weight: float,
) -> None:
    """Fill the unknown hole pixels of the patch around (y, x) with the weighted mean of its best matches."""
    width = hole.shape[1]
    pixels = image.reshape(-1, 4)
    shifts, coarse = _known_shifts(known, y, x, radius)
    centre = y * width + x
    short = candidates
    if len(candidates) > _SHORT_LIST * matches and len(coarse) >= 4:
        cost, _ = _compare(pixels, candidates, centre, coarse, offset_weight)
        short = _lowest(cost, _SHORT_LIST * matches)
        for k in range(len(short)):
            short[k] = candidates[short[k]]
    cost, offset = _compare(pixels, short, centre, shifts, offset_weight)
    order = _lowest(cost, min(matches, len(cost)))
    weight, total, least = np.empty(len(order)), 0.0, cost[order[0]]
    for k in range(len(order)):
        weight[k] = np.exp(-(cost[order[k]] - least) / (2.0 * (least + _NOISE)))
        total += weight[k]
    sure = 0.0
    for v in range(y - radius, y + radius + 1):
        for u in range(x - radius, x + radius + 1):
            sure += confidence[v, u]
    for v in range(y - radius, y + radius + 1):
        for u in range(x - radius, x + radius + 1):
            if hole[v, u] and not known[v, u]:
                shift = (v - y) * width + u - x
                for c in range(4):
                    value = 0.0
                    for k in range(len(order)):
                        value += weight[k] * (pixels[short[order[k]] + shift, c] + offset[order[k], c])
                    image[v, u, c] = value / total
                confidence[v, u] = sure / (2 * radius + 1) ** 2
    for v in range(y - radius, y + radius + 1):
        for u in range(x - radius, x + radius + 1):
            known[v, u] |= hole[v, u]


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _lowest(cost: Float32Array, n: int) -> NDArray[np.int64]:
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


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _known_shifts(known: BoolArray, y: int, x: int, radius: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Flat offsets of the known pixels of a patch from its centre, and of every second one along both axes."""
    width = known.shape[1]
    every, some = np.empty((2 * radius + 1) ** 2, np.int64), np.empty((2 * radius + 1) ** 2, np.int64)
    n, m = 0, 0
    for v in range(-radius, radius + 1):
        for u in range(-radius, radius + 1):
            if known[y + v, x + u]:
                every[n] = v * width + u
                n += 1
                if (v + radius) % 2 == 0 and (u + radius) % 2 == 0:
                    some[m] = v * width + u
                    m += 1
    return every[:n], some[:m]


@numba.njit(cache=True, nogil=True, fastmath=True)  # type: ignore[untyped-decorator]
def _compare(
    pixels: Float32Array, candidates: NDArray[np.int64], centre: int, shifts: NDArray[np.int64], offset_weight: float
) -> tuple[Float32Array, Float32Array]:
    """Cost of every candidate patch, [n], and the offset of colour and depth that brings it closest, [n, 4]."""
    count = np.float32(len(shifts))
    here = np.empty((len(shifts), 4), np.float32)
    for j in range(len(shifts)):
        for c in range(4):
            here[j, c] = pixels[centre + shifts[j], c]
    cost, offset = np.empty(len(candidates), np.float32), np.empty((len(candidates), 4), np.float32)
    for k in range(len(candidates)):
        s0, s1, s2, s3 = np.float32(0), np.float32(0), np.float32(0), np.float32(0)
        squares = np.float32(0)
        for j in range(len(shifts)):
            p = candidates[k] + shifts[j]
            d0, d1 = here[j, 0] - pixels[p, 0], here[j, 1] - pixels[p, 1]
            d2, d3 = here[j, 2] - pixels[p, 2], here[j, 3] - pixels[p, 3]
            s0, s1, s2, s3 = s0 + d0, s1 + d1, s2 + d2, s3 + d3
            squares += d0 * d0 + d1 * d1 + d2 * d2 + d3 * d3
        s0, s1, s2, s3 = s0 / count, s1 / count, s2 / count, s3 / count
        offset[k, 0], offset[k, 1], offset[k, 2], offset[k, 3] = s0, s1, s2, s3
        # An offset of depth costs nothing: along a slope every place has another one.
        cost[k] = squares / count - (1 - offset_weight) * (s0 * s0 + s1 * s1 + s2 * s2) - s3 * s3
    return cost, offset
