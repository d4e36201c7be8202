"""Rims: near anchors beside a depth edge, kept from covering what is behind them (O).

An anchor reaches past its cell; across a depth edge that reach is a thin near layer in front of far pixels, which
costs the input view up to 15 dB. Each rim anchor is shrunk until it ends where the far surface begins.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from orca.anchors import GaussianAnchors
from orca.conventions import Float32Array, Float64Array
from orca.threads import kernel

__all__ = ["shrink_rims"]


def shrink_rims(
    anchors: GaussianAnchors,
    pixels: Float64Array,
    reach: Float64Array,
    depth: Float32Array,
    edge_ratio: float,
    least: float,
    clearance: float = 0.0,
    slopes: Float64Array | None = None,
) -> GaussianAnchors:
    """Anchors whose footprints end before the nearest pixel that lies behind them.

    Args:
        anchors: lifted anchors.
        pixels: where each projects to in the canvas, [N, 2].
        reach: radius of each footprint in pixels, [N].
        depth: z-depth over the canvas, [H, W].
        edge_ratio: a pixel lies behind an anchor if it is deeper by this ratio.
        least: extents are never scaled by less than this, so that the rim stays closed.
        clearance: how many pixels before that pixel's centre they end. The input view does not tell: what covers the
            gap between two pixel centres shows only from elsewhere, as a rim of foreground on the background.
        slopes: d log z / d(pixel) of the surface that each lies on, [N, 2]: what goes deeper along it is not behind.
    """
    slopes = np.zeros_like(pixels) if slopes is None else slopes
    scale = np.ones(len(pixels))
    _scales(len(pixels), pixels, slopes, reach, depth, edge_ratio, clearance, scale)
    smaller = torch.from_numpy(2 * np.log(np.maximum(scale, least))).float()
    return replace(anchors, log_variances=anchors.log_variances + smaller[:, None])


@kernel(error_model="numpy")
def _scales(
    first: int,
    end: int,
    pixels: Float64Array,
    slopes: Float64Array,
    reach: Float64Array,
    depth: Float32Array,
    edge_ratio: float,
    clearance: float,
    out: Float64Array,
) -> None:
    """Distance to the nearest pixel centre that lies behind each anchor, less the clearance, over its reach, [N]."""
    height, width = depth.shape
    for i in range(first, end):
        x, y, r = pixels[i, 0], pixels[i, 1], reach[i]
        own = depth[min(max(int(y), 0), height - 1), min(max(int(x), 0), width - 1)]
        nearest = (r + clearance) ** 2
        for row in range(max(0, int(np.ceil(y - r - 0.5))), min(height, int(np.floor(y + r - 0.5)) + 1)):
            for column in range(max(0, int(np.ceil(x - r - 0.5))), min(width, int(np.floor(x + r - 0.5)) + 1)):
                dx, dy = column + 0.5 - x, row + 0.5 - y
                if depth[row, column] > edge_ratio * own:
                    along = max(0.0, slopes[i, 0] * dx + slopes[i, 1] * dy)
                    if depth[row, column] > edge_ratio * own * np.exp(along):
                        nearest = min(nearest, dx * dx + dy * dy)
        out[i] = max(0.0, np.sqrt(nearest) - clearance) / r
