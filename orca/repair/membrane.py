"""Continue an image from its donor pixels: a smooth membrane by push and pull, and texture mirrored across the edge."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from orca.conventions import Float32Array
from orca.repair.components import BoolArray

__all__ = ["linear_trend", "membrane", "mirrored_detail"]


def membrane(values: Float32Array, known: BoolArray) -> Float32Array:
    """Fill an image smoothly from its known pixels, each filled value a weighted mean of them.

    Push-pull over a pyramid (Gortler et al., The Lumigraph, 1996): known pixels are averaged down level by level,
    and what is missing at a level is interpolated from the next coarser one. Linear in the number of pixels.

    Args:
        values: [h, w, c]; ignored where not known.
        known: [h, w], at least one True.

    Returns:
        [h, w, c], equal to ``values`` where known and within the range of the known values elsewhere.
    """
    weight = known.astype(np.float32)[..., None]
    level = np.where(known[..., None], values, np.float32(0.0)).astype(np.float32)
    pyramid = [(level, weight)]
    while weight.min() < 1.0 and weight.size > 1:
        level, weight = _push(level, weight)
        pyramid.append((level, weight))
    filled = pyramid[-1][0] / pyramid[-1][1]
    for level, weight in reversed(pyramid[:-1]):
        size = (level.shape[1], level.shape[0])
        finer = cv2.resize(filled, size, interpolation=cv2.INTER_LINEAR).reshape(level.shape)
        filled = level + (1.0 - weight) * finer
    return np.asarray(filled, np.float32)


def _push(level: Float32Array, weight: Float32Array) -> tuple[Float32Array, Float32Array]:
    """One level coarser: sums over 2 x 2 blocks, the weight saturated at 1 (``level`` is premultiplied by it)."""
    height, width = level.shape[0] + level.shape[0] % 2, level.shape[1] + level.shape[1] % 2
    pad = ((0, height - level.shape[0]), (0, width - level.shape[1]), (0, 0))
    blocks = np.pad(level, pad).reshape(height // 2, 2, width // 2, 2, -1).sum(axis=(1, 3))
    total = np.pad(weight, pad).reshape(height // 2, 2, width // 2, 2, 1).sum(axis=(1, 3))
    saturated = np.minimum(total, 1.0)
    return blocks * (saturated / np.maximum(total, 1e-12)), saturated


def linear_trend(values: Float32Array, known: BoolArray, min_explained: float = 0.98) -> Float32Array:
    """The least-squares plane a + b x + c y through the known values, [h, w]; 0 where they do not lie on one.

    Args:
        values: [h, w]; ignored where not known.
        known: [h, w], at least one True.
        min_explained: O. Share of the variance that a plane must explain to be continued beyond its support.
    """
    height, width = values.shape
    y, x = np.nonzero(known)
    target = values[known].astype(np.float64)
    spread = float(np.sum((target - target.mean()) ** 2))
    if len(target) < 3 or spread == 0.0:
        return np.zeros_like(values)
    columns = np.stack([np.ones(len(x)), x / width, y / height], axis=1)
    coefficients = np.linalg.lstsq(columns, target, rcond=None)[0]
    if float(np.sum((columns @ coefficients - target) ** 2)) > (1.0 - min_explained) * spread:
        return np.zeros_like(values)
    a, b, c = coefficients
    rows, cols = np.mgrid[0:height, 0:width]
    return np.asarray(a + b * cols / width + c * rows / height, np.float32)


def mirrored_detail(values: Float32Array, known: BoolArray, band: float, sigma: float) -> Float32Array:
    """Fine structure of the known pixels, reflected about the nearest known pixel into the unknown ones.

    Args:
        values: [h, w, c]; ignored where not known.
        known: [h, w], at least one True.
        band: depth of the donor band in pixels; further in, the reflection turns back and forth inside it.
        sigma: standard deviation in pixels of the blur that separates structure from base.

    Returns:
        [h, w, c]: values minus their blur among the known pixels; 0 where a reflection misses the known pixels.
    """
    weight = known.astype(np.float32)
    masked = np.where(known[..., None], values, np.float32(0.0)).astype(np.float32)
    share = np.maximum(cv2.GaussianBlur(weight, (0, 0), sigma), 1e-6)[..., None]
    base = cv2.GaussianBlur(masked, (0, 0), sigma).reshape(masked.shape) / share
    detail = (masked - base) * weight[..., None]
    y, x = np.nonzero(~known)
    my, mx = _reflect(known, y, x, band)
    detail[y, x] = detail[my, mx]
    return np.asarray(detail, np.float32)


def _reflect(
    known: BoolArray, y: NDArray[np.intp], x: NDArray[np.intp], band: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Mirror image of each pixel (y, x) about its nearest known one, folded into ``band``; itself if off the image."""
    _, labels = cv2.distanceTransformWithLabels(
        (~known).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    ky, kx = np.nonzero(known)
    where = np.zeros(int(labels.max()) + 1, np.intp)
    where[labels[ky, kx]] = np.arange(len(ky))
    nearest = where[labels[y, x]]
    dy, dx = ky[nearest] - y, kx[nearest] - x
    distance = np.hypot(dy, dx)
    folded = band - np.abs(np.mod(distance, 2 * band) - band)
    my = np.rint(ky[nearest] + dy / distance * folded).astype(np.intp)
    mx = np.rint(kx[nearest] + dx / distance * folded).astype(np.intp)
    inside = (my >= 0) & (mx >= 0) & (my < known.shape[0]) & (mx < known.shape[1])
    return np.where(inside, my, y), np.where(inside, mx, x)
