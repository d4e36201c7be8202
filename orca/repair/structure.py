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
from orca.repair.patches import compare, lowest, make_spans, short_list

__all__ = ["ExemplarRules", "continue_structure"]

_MIN_CANDIDATES = 64
_FLAT = 1e-3  # priority of a patch without any structure; gradients count from here
_NOISE = 1e-4  # squared colour error that is rendering noise: matches this good are equally good
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
    scale = np.float32(1.0 / float(np.median(inverse_depth[source])))
    image = np.dstack([rgb, scale * inverse_depth]).astype(np.float32)
    image[~source] = 0.0
    # A padded frame, so that no patch reaches outside; a plane for each channel.
    radius, (height, width) = rules.radius, hole.shape
    pad = ((radius, radius), (radius, radius))
    planes = np.ascontiguousarray(np.pad(image, (*pad, (0, 0))).transpose(2, 0, 1))
    known, inside = np.pad(source, pad), np.pad(hole, pad)
    strength = np.pad(_structure(rgb, source), pad)
    candidates = (candidates // width + radius) * (width + 2 * radius) + candidates % width + radius
    spans, candidates = make_spans(candidates)
    matches = min(rules.matches, len(candidates))
    _fill(planes, known, inside, strength, candidates, spans, radius, matches, np.float32(rules.offset_weight))
    filled = planes[:, radius : radius + height, radius : radius + width]
    known = known[radius : radius + height, radius : radius + width]
    return np.ascontiguousarray(filled[:3].transpose(1, 2, 0)), filled[3] / scale, np.asarray(known & hole)


def _structure(rgb: Float32Array, source: BoolArray) -> Float32Array:
    """Gradient magnitude inside the source, 0 elsewhere and at its border, [h, w]."""
    safe = np.where(source[..., None], rgb, np.float32(0.0)).astype(np.float32)
    dx, dy = cv2.Sobel(safe, cv2.CV_32F, 1, 0, scale=0.125), cv2.Sobel(safe, cv2.CV_32F, 0, 1, scale=0.125)
    inner = cv2.erode(source.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    return np.asarray(np.where(inner, np.sqrt((dx**2 + dy**2).sum(2)), 0.0), np.float32)


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _fill(
    planes: Float32Array,
    known: BoolArray,
    hole: BoolArray,
    strength: Float32Array,
    candidates: NDArray[np.int64],
    spans: NDArray[np.int64],
    radius: int,
    matches: int,
    offset_weight: float,
) -> None:
    """Patch after patch, the one with the highest priority first, until nothing of the hole touches the known."""
    height, width = hole.shape
    confidence = known.astype(np.float32)
    priority = np.full((height, width), np.float32(-1.0))
    top, bottom, left, right = height, radius, width, radius  # of the hole
    for y in range(radius, height - radius):
        for x in range(radius, width - radius):
            if hole[y, x]:
                top, bottom, left, right = min(top, y), max(bottom, y + 1), min(left, x), max(right, x + 1)
                priority[y, x] = _priority(known, hole, confidence, strength, y, x, radius)
    while True:
        y, x = _highest(priority, top, bottom, left, right)
        if y < 0:
            return
        _paste(planes, known, hole, confidence, candidates, spans, y, x, radius, matches, offset_weight)
        reach = 2 * radius + 1
        for v in range(max(top, y - reach), min(bottom, y + reach + 1)):
            for u in range(max(left, x - reach), min(right, x + reach + 1)):
                priority[v, u] = _priority(known, hole, confidence, strength, v, u, radius)


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _highest(priority: Float32Array, top: int, bottom: int, left: int, right: int) -> tuple[int, int]:
    """Where the highest priority of a box is, the first of equal ones; -1, -1 if there is nothing to fill."""
    most, where_y, where_x = np.float32(-1.0), -1, -1
    for y in range(top, bottom):
        for x in range(left, right):
            if priority[y, x] > most:
                most, where_y, where_x = priority[y, x], y, x
    return where_y, where_x


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
    planes: Float32Array,
    known: BoolArray,
    hole: BoolArray,
    confidence: Float32Array,
    candidates: NDArray[np.int64],
    spans: NDArray[np.int64],
    y: int,
    x: int,
    radius: int,
    matches: int,
    offset_weight: float,
) -> None:
    """Fill the unknown hole pixels of the patch around (y, x) with the weighted mean of its best matches."""
    width = hole.shape[1]
    pixels = planes.reshape(4, -1)
    shifts, coarse = _known_shifts(known, y, x, radius)
    centre = y * width + x
    short = candidates
    if len(candidates) > _SHORT_LIST * matches:
        rough = coarse if len(coarse) >= 4 else shifts
        short = short_list(pixels, candidates, spans, centre, rough, offset_weight, _SHORT_LIST * matches)
    cost, offset = compare(pixels, short, centre, shifts, offset_weight)
    order = lowest(cost, min(matches, len(cost)))
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
                        value += weight[k] * (pixels[c, short[order[k]] + shift] + offset[order[k], c])
                    planes[c, v, u] = value / total
                confidence[v, u] = sure / (2 * radius + 1) ** 2
    for v in range(y - radius, y + radius + 1):
        for u in range(x - radius, x + radius + 1):
            known[v, u] |= hole[v, u]


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
