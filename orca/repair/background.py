"""Which pixels around a hole belong to the background that the hole uncovers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from orca.conventions import Float32Array, Float64Array
from orca.repair.components import BoolArray
from orca.repair.freespace import inward_angle, nearest_hole_pixels, seen_through

__all__ = ["background_pixels"]

LOCAL_SPAN = 0.12
"""O. Around a pixel, a relative range of inverse depth below this is one surface: nothing to separate."""

ACROSS_RATIO = 1.1
"""O. A pixel is in front of what lies across the hole if its inverse depth is this many times larger."""

SILHOUETTE = 2
"""O. Pixels this close to the foreground are blended with it and are no donors."""

_ANGLES = (-0.45, 0.0, 0.45)
_MAX_STEPS = 64


def background_pixels(
    depth: Float32Array, ring: BoolArray, hole: BoolArray, reach: int, least: Float32Array | None = None
) -> BoolArray:
    """The ring pixels that are not foreground.

    A foreground pixel passes two tests. *Near*: its inverse depth is in the nearer half of the local range, in a
    window that reaches across the hole. *Across*: seen through the hole along its normal, the other side is farther.
    A disocclusion always has a far side; ground that merely comes closer has none, nor has what the image border
    cuts off. A percentile of the whole ring, which the paper uses, keeps one corner of a tilted background.

    With ``least``, what the input saw through decides instead (`seen_through`).

    Args:
        depth: positive z-depth where ``ring`` is set, [h, w].
        ring: candidates, [h, w].
        hole: the component, [h, w].
        reach: outer radius of the ring in pixels.
        least: smallest possible z-depth of each hole pixel (`InputSurface.least_depth`), [h, w]; 0 elsewhere.

    Returns:
        Donors, a subset of ``ring``, [h, w].
    """
    if not ring.any():
        return ring.copy()
    if least is not None:
        return np.asarray(ring & ~_widened(seen_through(depth, ring, hole, least)))
    inverse = np.zeros(ring.shape, np.float32)
    inverse[ring] = 1.0 / depth[ring]
    thickness = 2.0 * float(cv2.distanceTransform(np.pad(hole, 1).astype(np.uint8), cv2.DIST_L2, 5).max())
    near = _locally_near(inverse, ring, int(thickness) + 2 * reach)
    if not near.any():
        return ring.copy()
    foreground = near & (inverse > ACROSS_RATIO * _across(inverse, ring, hole, 1.5 * thickness + 2 * reach))
    return np.asarray(ring & ~_widened(foreground))


def _widened(foreground: BoolArray) -> BoolArray:
    side = 2 * SILHOUETTE + 1
    return np.asarray(cv2.dilate(foreground.astype(np.uint8), np.ones((side, side), np.uint8)), bool)


def _locally_near(inverse: Float32Array, ring: BoolArray, radius: int) -> BoolArray:
    """Ring pixels in the nearer half of the range of inverse depth in the square window around them."""
    row = np.ones((1, 2 * radius + 1), np.uint8)
    far = np.where(ring, inverse, np.float32(np.inf))
    low = _window(cv2.erode, far, row, np.inf)
    high = _window(cv2.dilate, np.where(ring, inverse, np.float32(-np.inf)), row, -np.inf)
    with np.errstate(invalid="ignore"):
        near = (inverse > 0.5 * (low + high)) & (high - low > LOCAL_SPAN * inverse)
    return np.asarray(near & ring)


def _window(extremum: Callable[..., Any], image: Float32Array, row: NDArray[np.uint8], outside: float) -> Float32Array:
    """Minimum (cv2.erode) or maximum (cv2.dilate) over a square window, as two one-dimensional passes."""
    for kernel in (row, row.T):
        image = extremum(image, kernel, borderType=cv2.BORDER_CONSTANT, borderValue=outside)
    return image


def _across(inverse: Float32Array, ring: BoolArray, hole: BoolArray, length: float) -> Float64Array:
    """Inverse depth across the hole from each ring pixel, the farthest of three directions; inf if nothing is there.

    A ring pixel looks from its nearest hole pixel along the hole's inward normal there, and to both sides of it.
    """
    y, x, index = nearest_hole_pixels(ring, hole)
    angle = inward_angle(hole, y, x)[:, None]
    steps = np.arange(2.0, length, max(2.0, length / _MAX_STEPS))
    seen = np.full(len(y), np.inf)
    height, width = ring.shape
    for turn in _ANGLES:
        px = np.rint(x[:, None] + np.cos(angle + turn) * steps).astype(np.intp)
        py = np.rint(y[:, None] + np.sin(angle + turn) * steps).astype(np.intp)
        inside = (px >= 0) & (py >= 0) & (px < width) & (py < height)
        px, py = px.clip(0, width - 1), py.clip(0, height - 1)
        hit = inside & ring[py, px]
        first = np.argmax(hit, axis=1)
        rows = np.flatnonzero(hit.any(axis=1))
        seen[rows] = np.minimum(seen[rows], inverse[py[rows, first[rows]], px[rows, first[rows]]])
    result = np.full(ring.shape, np.inf)
    result[ring] = seen[index]
    return result
