"""Where a repair needs anchors: cells of a few pixels where its target is smooth, single pixels elsewhere."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from orca.config import RenderConfig
from orca.conventions import Float32Array, Float64Array
from orca.repair.donors import FillTarget

__all__ = ["TargetCells", "cells_of", "split_cells"]

T = TypeVar("T", np.float64, np.bool_)

_FILLED = {4: 12, 2: 2, 1: 1}
"""Side of a cell -> how many of its pixels must be in the hole. Holes are slivers and sieves, seldom whole squares:
with some of it outside, a cell closes more, and a second view loses nothing (Motorcycle). Larger cells reach too far
beyond the hole: an anchor covers 1.6 times its cell's side."""

_ONE_SURFACE = 1 + RenderConfig.layer_gap_relative
"""Depths nearer than this ratio are one surface, as hits of a ray are."""


@dataclass(frozen=True, eq=False)
class TargetCells:
    """Squares of a hole's pixels, one anchor each.

    Attributes:
        centres: (x, y) in pixels, a pixel's centre at .5, [n, 2].
        sides: in pixels, [n].
        rgb: mean target colour, [n, 3].
        depth: mean target z-depth, [n].
    """

    centres: Float64Array
    sides: Float64Array
    rgb: Float32Array
    depth: Float64Array

    def __len__(self) -> int:
        return len(self.sides)

    def subset(self, which: NDArray[np.bool_]) -> TargetCells:
        """Some of them, [n]."""
        return TargetCells(self.centres[which], self.sides[which], self.rgb[which], self.depth[which])


def cells_of(target: FillTarget, tolerance: float, limit: int) -> TargetCells:
    """As few cells as the target needs.

    Four pixels or sixteen become one cell where their squared colour error against their mean, summed over pixels and
    channels, is at most ``tolerance`` and they are one surface. Where more than ``limit`` cells are left, they are a
    regular grid instead, as coarse as it takes (paper: no repair has more anchors than so many).

    Args:
        target: pixels of the hole with colour and depth.
        tolerance: what a cell may leave; 0 keeps every pixel.
        limit: most cells.
    """
    cells = _merged(target, tolerance) if tolerance > 0 else _regular(target, 1)
    step = 1
    while len(cells) > limit:
        step += 1
        cells = _regular(target, step)
    return cells


def split_cells(cells: TargetCells, which: NDArray[np.bool_], target: FillTarget) -> TargetCells:
    """The cells with some of them [n] replaced by the pixels of the target that they hold."""
    low = (cells.centres[which] - cells.sides[which, None] / 2).astype(int)
    side = cells.sides[which].astype(int)
    left, top = (int(v.min()) for v in (target.x, target.y))
    inside = np.zeros((int(target.y.max()) - top + 1, int(target.x.max()) - left + 1), bool)
    for (x, y), s in zip(low - (left, top), side, strict=True):
        inside[max(0, y) : max(0, y + s), max(0, x) : max(0, x + s)] = True
    keep = inside[target.y - top, target.x - left]
    pixels = _regular(
        replace(target, y=target.y[keep], x=target.x[keep], rgb=target.rgb[keep], depth=target.depth[keep]), 1
    )
    parts = zip(*[(c.centres, c.sides, c.rgb, c.depth) for c in (cells.subset(~which), pixels)], strict=True)
    return TargetCells(*(np.concatenate(part) for part in parts))


def _regular(target: FillTarget, step: int) -> TargetCells:
    """One pixel of every square of ``step``, with the square's side."""
    keep = np.flatnonzero((target.y % step == step // 2) & (target.x % step == step // 2))
    if len(keep) == 0:  # a sliver that the grid misses
        keep = np.arange(0, len(target.y), step * step)
    centres = np.stack([target.x[keep] + 0.5, target.y[keep] + 0.5], 1)
    depth = target.depth[keep].astype(np.float64)
    return TargetCells(centres, np.full(len(keep), float(step)), target.rgb[keep], depth)


def _merged(target: FillTarget, tolerance: float) -> TargetCells:
    """The largest cells that are smooth enough."""
    largest = max(_FILLED)
    left, top = (int(v.min()) // largest * largest for v in (target.x, target.y))
    x, y = target.x - left, target.y - top
    height, width = ((int(v.max()) // largest + 1) * largest for v in (y, x))
    free = np.zeros((height, width), bool)  # pixels that are in no cell yet
    free[y, x] = True
    rgb, depth = np.zeros((height, width, 3)), np.zeros((height, width))
    rgb[y, x], depth[y, x] = target.rgb, target.depth
    parts = []
    for side, filled in _FILLED.items():
        which = _squares(free, side)
        mean, error = _mean_and_error(_squares(rgb, side), which)
        middle, _ = _mean_and_error(_squares(depth, side)[..., None], which)
        chosen = which.sum(-1) >= filled
        if side > 1:
            chosen &= (error <= tolerance) & _one_surface(_squares(depth, side), which)
        row, column = np.nonzero(chosen)
        free &= ~chosen.repeat(side, 0).repeat(side, 1)
        centres = (np.stack([column, row], 1) + 0.5) * side + (left, top)
        parts.append((centres, np.full(len(row), float(side)), mean[chosen], middle[chosen, 0]))
    centres, sides, colours, depths = (np.concatenate(part) for part in zip(*parts, strict=True))
    return TargetCells(np.asarray(centres, np.float64), sides, colours.astype(np.float32), depths)


def _squares(image: NDArray[T], side: int) -> NDArray[T]:
    """The pixels of each square that tiles an image [H, W, ...], [H / side, W / side, side * side, ...]."""
    height, width = image.shape[:2]
    tiles = image.reshape(height // side, side, width // side, side, *image.shape[2:]).swapaxes(1, 2)
    return tiles.reshape(height // side, width // side, side * side, *image.shape[2:])


def _mean_and_error(values: Float64Array, which: NDArray[np.bool_]) -> tuple[Float64Array, Float64Array]:
    """Mean [h, w, C] of those values [h, w, n, C] that count, and their squared error against it, summed, [h, w]."""
    count = np.maximum(which.sum(-1), 1)[..., None]
    mean = (values * which[..., None]).sum(2) / count
    return mean, (np.square(values - mean[:, :, None]) * which[..., None]).sum((2, 3))


def _one_surface(depth: Float64Array, which: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Whether the depths [h, w, n] that count are within a ratio of each other, [h, w]."""
    farthest = np.where(which, depth, 0).max(-1)
    nearest = np.where(which, depth, np.inf).min(-1)
    return np.asarray(farthest <= _ONE_SURFACE * nearest)
