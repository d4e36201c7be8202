"""Stage 1: anchors on a planar grid over the canvas (paper Sec. 3.1)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from orca.anchors import FEATURE_DIM, GaussianAnchors, Stage
from orca.config import PlacementConfig, PlanarConfig
from orca.conventions import Float64Array
from orca.field.decoders import DENSITY_CHANNEL
from orca.stages.canvas import Canvas
from orca.stages.placement import Cells, Quadtree

__all__ = [
    "PLANE_DEPTH",
    "PlanarGrid",
    "grid_of",
    "place",
    "planar_anchors",
    "regular_grid",
    "rest_positions",
    "tree_by_need",
]

PLANE_DEPTH = 1.0  # z-depth of the plane; any value does, since stage 2 moves every anchor along its own ray


@dataclass(frozen=True, eq=False)
class PlanarGrid:
    """Where the anchors sit in the image.

    Attributes:
        pixels: canvas pixel position of each anchor, [N, 2] float64.
        spacing: grid spacing at each anchor in pixels, [N] float64.
        in_original: whether it lies inside the original image, [N] bool.
    """

    pixels: Float64Array
    spacing: Float64Array
    in_original: NDArray[np.bool_]


def place(canvas: Canvas, config: PlanarConfig) -> PlanarGrid:
    """Anchor positions at once, by the configured rule; where growth is configured, by need."""
    return regular_grid(canvas, config) if config.placement.kind == "grid" else by_need(canvas, config)


def by_need(canvas: Canvas, config: PlanarConfig) -> PlanarGrid:
    """Anchors where image and depth need them, `anchors_per_pixel` times the original's pixels in all."""
    rows, columns = canvas.original
    budget = round(config.anchors_per_pixel * canvas.depth[rows, columns].size)
    return grid_of(canvas, tree_by_need(canvas, config.placement).cells(budget))


def tree_by_need(canvas: Canvas, config: PlacementConfig) -> Quadtree:
    """Every quadtree over the canvas, an error in the outpainted margin counting less."""
    margin = np.ones(canvas.depth.shape, bool)
    margin[canvas.original] = False
    importance = np.where(margin, np.float32(config.margin_importance), np.float32(1))
    return Quadtree(canvas.image, canvas.depth, importance, config, margin)


def grid_of(canvas: Canvas, cells: Cells) -> PlanarGrid:
    """An anchor for each cell of the canvas."""
    left, top, right, bottom = canvas.margins
    height, width = canvas.depth.shape
    low, high = np.array([left, top]), np.array([width - right, height - bottom])
    # The last cells of a side that 8 does not divide may have their centres beyond the canvas.
    centres = np.minimum(cells.centres, np.array([width, height]) - 0.5)
    inside = ((centres >= low) & (centres < high)).all(1)
    return PlanarGrid(cells.centres, cells.sizes, np.asarray(inside))


def regular_grid(canvas: Canvas, config: PlanarConfig) -> PlanarGrid:
    """A regular grid inside the original and a coarser one, aligned with it, in the outpainted margin."""
    left, top, right, bottom = canvas.margins
    height, width = canvas.image.shape[:2]
    inner_w, inner_h = width - left - right, height - top - bottom
    spacing = 1 / math.sqrt(config.anchors_per_pixel)
    nx, ny = max(2, round(inner_w / spacing)), max(2, round(inner_h / spacing))
    inner = _cells(nx, ny, inner_w / nx, inner_h / ny) + np.array([left, top])
    coarse = spacing * config.margin_spacing
    # The coarse grid continues beyond the original on each side by whole cells, so that no anchor lies inside it.
    mx, my = max(1, round(inner_w / coarse)), max(1, round(inner_h / coarse))
    cw, ch = inner_w / mx, inner_h / my
    ox, oy = math.ceil(left / cw), math.ceil(top / ch)
    columns, rows = ox + mx + math.ceil(right / cw), oy + my + math.ceil(bottom / ch)
    outer = _cells(columns, rows, cw, ch) + np.array([left - ox * cw, top - oy * ch])
    outer = outer[~((outer > [left, top]) & (outer < [width - right, height - bottom])).all(1)]
    return PlanarGrid(
        np.concatenate([inner, outer]),
        np.concatenate([np.full(len(inner), max(inner_w / nx, inner_h / ny)), np.full(len(outer), max(cw, ch))]),
        np.arange(len(inner) + len(outer)) < len(inner),
    )


def _cells(nx: int, ny: int, width: float, height: float) -> Float64Array:
    """Centres of nx by ny cells, row by row, [nx * ny, 2]."""
    x, y = np.meshgrid((np.arange(nx) + 0.5) * width, (np.arange(ny) + 0.5) * height)
    return np.stack([x.ravel(), y.ravel()], 1)


def planar_anchors(canvas: Canvas, grid: PlanarGrid, config: PlanarConfig) -> GaussianAnchors:
    """Anchors on the plane z = `PLANE_DEPTH` in front of the camera, discs that face along its axis.

    Features are zero but for the density channel; a solver or the hash encoding fills the rest.
    """
    means = canvas.camera.unproject(grid.pixels, np.full(len(grid.pixels), PLANE_DEPTH))
    sigma = config.kappa * grid.spacing * PLANE_DEPTH / canvas.camera.K[0, 0]
    deviations = np.stack([sigma, sigma, sigma * config.thickness], 1)
    n = len(means)
    features = torch.zeros(n, FEATURE_DIM)
    features[:, DENSITY_CHANNEL] = 1.0
    identity = torch.zeros(n, 4)
    identity[:, 0] = 1.0
    stage = np.where(grid.in_original, Stage.ORIGINAL, Stage.OUTPAINTED).astype(np.uint8)
    return GaussianAnchors(
        means=_float32(means),
        log_variances=_float32(2 * np.log(deviations)),
        quaternions=identity,
        opacity_logits=torch.full((n,), config.opacity_logit),
        features=features,
        stage=torch.from_numpy(stage),
    )


def rest_positions(canvas: Canvas, grid: PlanarGrid) -> Tensor:
    """Canonical image coordinates in [0, 1]^2 at which the hash encoding is read, [N, 2]."""
    height, width = canvas.image.shape[:2]
    return _float32(grid.pixels / [width, height])


def _float32(array: Float64Array) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32))
