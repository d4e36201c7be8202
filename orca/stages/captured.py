"""What of an error finer cells could take off: the part of it that their means express."""

from __future__ import annotations

import cv2
import numpy as np

from orca.conventions import Float32Array, Float64Array
from orca.stages.placement import Cells, cell_sums

__all__ = ["captured"]


def captured(cells: Cells, error: Float32Array) -> Float64Array:
    """Squared error that splitting each cell could take off, for each split that it takes, [N]; 0 for a pixel.

    Anchors of half a cell's size take off about what the means of its quarters hold of the error and the cell's own
    mean does not. A split that takes off little may make others possible that take off more: the best of all depths
    counts, over the splits that getting there takes.

    Args:
        cells: cells of a quadtree over the image, sides powers of two.
        error: what each pixel lacks, signed, [H, W, 3].
    """
    sides = [int(side) for side in np.unique(cells.sizes)]
    largest = sides[-1]
    padded = np.pad(error, ((0, -error.shape[0] % largest), (0, -error.shape[1] % largest), (0, 0)))
    held = _held(padded, largest)
    out = np.zeros(len(cells.sizes))
    for side in sides:
        (some,) = np.nonzero(cells.sizes == side)
        column, row = np.floor(cells.centres[some] / side).astype(int).T
        finer = side
        while finer > 1:
            finer //= 2
            across = side // finer
            gain = (cell_sums(held[finer], across) - held[side])[row, column] * 3 / (across**2 - 1)
            out[some] = np.maximum(out[some], gain)
    return out


def _held(error: Float32Array, largest: int) -> dict[int, Float64Array]:
    """By side up to the largest: squared error that the mean of each square of it holds, [H / side, W / side]."""
    out, means, side = {}, error, 1
    while side <= largest:
        if side > 1:
            size = (means.shape[1] // 2, means.shape[0] // 2)
            means = np.asarray(cv2.resize(means, size, interpolation=cv2.INTER_AREA), np.float32)
        out[side] = np.asarray(np.einsum("hwc,hwc->hw", means, means) * np.float64(side**2))
        side *= 2
    return out
