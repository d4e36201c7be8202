"""Which pixels around a hole are in front of what it uncovers, told by the space that the input view looked through.

What the input saw through is empty. A surface beside the hole that, continued into it, would come to lie in that space
cannot go on there: it is foreground. The background can, up to the hole's far side, where it was hidden.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from orca.conventions import Float32Array, Float64Array
from orca.repair.components import BoolArray

__all__ = ["inward_angle", "nearest_hole_pixels", "seen_through"]

_RATIO = 1.04
"""O. A surface is foreground if, continued, it would have to be this many times farther than it is."""

_SLOPE_LIMIT = 0.25
"""O. A slope is continued by at most this share of the inverse depth: steep sides of the foreground end somewhere."""

_SLOPE_SIGMA = 2.0
_ANGLES = (-0.45, 0.0, 0.45)


def seen_through(depth: Float32Array, ring: BoolArray, hole: BoolArray, least: Float32Array) -> BoolArray:
    """The ring pixels whose surface cannot go on into the hole, [h, w].

    Each ring pixel looks from its nearest hole pixel along the hole's inward normal there, and to both sides of it, no
    further than the hole is thick (along a wedge it does not look to the far end), for the place of the largest least
    depth. Its surface is continued to there with its own slope.

    Args:
        depth: positive z-depth where ``ring`` is set, [h, w].
        ring: candidates, [h, w].
        hole: the component, [h, w].
        least: smallest possible z-depth of each hole pixel (`InputSurface.least_depth`), [h, w].
    """
    body = cv2.morphologyEx(hole.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)).astype(bool)
    body = body if body.any() else hole  # threads and sieves on a stretched side say nothing about the far side
    y, x, index = nearest_hole_pixels(ring, body)
    far, far_y, far_x = _farthest_inside(least, body, y, x)
    inverse = np.zeros(ring.shape, np.float32)
    inverse[ring] = 1.0 / depth[ring]
    slope_x, slope_y = _slopes(inverse, ring)
    ry, rx = np.nonzero(ring)
    own = inverse[ry, rx].astype(np.float64)
    change = slope_x[ry, rx] * (far_x[index] - rx) + slope_y[ry, rx] * (far_y[index] - ry)
    continued = own + np.clip(change, -_SLOPE_LIMIT * own, _SLOPE_LIMIT * own)
    foreground = np.zeros(ring.shape, bool)
    foreground[ry, rx] = continued * far[index] > _RATIO
    return foreground


def _farthest_inside(
    least: Float32Array, hole: BoolArray, y: NDArray[np.intp], x: NDArray[np.intp]
) -> tuple[Float64Array, NDArray[np.intp], NDArray[np.intp]]:
    """The largest least depth that hole pixels (y, x) see across the hole, and where it is, [n] each."""
    thickness = cv2.distanceTransform(np.pad(hole, 1).astype(np.uint8), cv2.DIST_L2, 5)[1:-1, 1:-1]
    angle = inward_angle(hole, y, x)
    far, far_y, far_x = least[y, x].astype(np.float64), y.copy(), x.copy()
    height, width = hole.shape
    for turn in _ANGLES:
        going, thickest = np.ones(len(y), bool), thickness[y, x].copy()
        for step in range(1, 2 * int(thickness.max()) + 3):
            px = np.rint(x + np.cos(angle + turn) * step).astype(np.intp).clip(0, width - 1)
            py = np.rint(y + np.sin(angle + turn) * step).astype(np.intp).clip(0, height - 1)
            going &= hole[py, px] & (step <= 2.0 * thickest + 2.0)
            if not going.any():
                break
            better = going & (least[py, px] > far)
            far[better], far_y[better], far_x[better] = least[py, px][better], py[better], px[better]
            thickest = np.where(going, np.maximum(thickest, thickness[py, px]), thickest)
    return far, far_y, far_x


def _slopes(inverse: Float32Array, ring: BoolArray) -> tuple[Float64Array, Float64Array]:
    """Smoothed slope of the inverse depth per pixel along x and y, [h, w] each; one-sided at edges, 0 where unknown."""
    known = cv2.GaussianBlur(ring.astype(np.float64), (0, 0), _SLOPE_SIGMA)
    out = []
    for axis in (1, 0):
        step = np.diff(inverse, axis=axis).astype(np.float64)
        both = np.logical_and(*((ring[:, 1:], ring[:, :-1]) if axis else (ring[1:], ring[:-1])))
        step = np.where(both, step, np.inf)
        pad = [(0, 0), (0, 0)]
        pad[axis] = (1, 1)
        step = np.pad(step, pad, constant_values=np.inf)
        back, ahead = (step[:, :-1], step[:, 1:]) if axis else (step[:-1], step[1:])
        smaller = np.where(np.abs(ahead) < np.abs(back), ahead, back)
        smaller = np.where(np.isfinite(smaller) & ring, smaller, 0.0)
        out.append(np.asarray(cv2.GaussianBlur(smaller, (0, 0), _SLOPE_SIGMA) / np.maximum(known, 1e-6)))
    return out[0], out[1]


def inward_angle(hole: BoolArray, y: NDArray[np.intp], x: NDArray[np.intp]) -> Float64Array:
    """Direction of the hole's inward normal at hole pixels, in radians, [n]."""
    smooth = cv2.GaussianBlur(hole.astype(np.float32), (0, 0), 3.0, borderType=cv2.BORDER_REPLICATE)
    nx = cv2.Sobel(smooth, cv2.CV_32F, 1, 0)[y, x]
    ny = cv2.Sobel(smooth, cv2.CV_32F, 0, 1)[y, x]
    return np.asarray(np.arctan2(ny, nx), np.float64)


def nearest_hole_pixels(
    ring: BoolArray, hole: BoolArray
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """(y, x) of the hole pixels that are nearest to some ring pixel, and for each ring pixel the index of its one."""
    _, labels = cv2.distanceTransformWithLabels(
        (~hole).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    y, x = np.nonzero(hole)
    position = np.zeros(int(labels.max()) + 1, np.intp)
    position[labels[y, x]] = np.arange(len(y))
    used, index = np.unique(position[labels[ring]], return_inverse=True)
    return y[used], x[used], index.astype(np.intp)
