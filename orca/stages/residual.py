"""What a fit on some cells leaves of the error, and what splitting each of them promises."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from orca.anchors import GaussianAnchors
from orca.config import GrowthConfig, PlanarConfig, RenderConfig
from orca.conventions import Float32Array, Float64Array
from orca.field.decoders import analytic_decoders
from orca.render.renderer import Renderer
from orca.stages.canvas import Canvas
from orca.stages.captured import captured
from orca.stages.linear import linear_view
from orca.stages.observations import Observation
from orca.stages.placement import Cells, cell_of_pixel, edge_error
from orca.stages.planar import PlanarGrid, tree_by_need
from orca.stages.solve import refine

__all__ = ["Fitter", "Residual", "psnr_of", "squared_of"]

_COARSE = 4  # pixels: one ray of four tells of cells of this size and more whether to split them


def psnr_of(squared: float, pixels: int) -> float:
    """PSNR in dB of a squared error that is summed over pixels and channels."""
    return -10 * math.log10(max(squared / pixels / 3, 1e-12))


def squared_of(psnr_db: float, pixels: int) -> float:
    """The inverse of `psnr_of`."""
    return float(10 ** (-psnr_db / 10) * pixels * 3)


@dataclass(frozen=True, eq=False)
class Residual:
    """Where a fit errs.

    Attributes:
        place: canvas pixel of each ray, row-major, [R]; those of the original come first.
        squared: squared error of each ray times the pixels of its image that it stands for, [R].
        inside: how many rays are the original's.
        pixels: how many pixels the original has.
        lacking: colour that each canvas pixel lacks, in the margin times the root of its importance, [H, W, 3].
    """

    place: NDArray[np.int64]
    squared: Float64Array
    inside: int
    pixels: int
    lacking: Float32Array

    @property
    def original(self) -> float:
        """Squared error of the input view, summed."""
        return float(self.squared[: self.inside].sum())

    @property
    def psnr_db(self) -> float:
        """PSNR of the input view."""
        return psnr_of(self.original, self.pixels)


class Fitter:
    """Solves for the colours of a grid, and says where the error lies."""

    def __init__(
        self,
        canvas: Canvas,
        observed: Sequence[Observation],
        lift: Callable[[PlanarGrid], GaussianAnchors],
        planar: PlanarConfig,
        render: RenderConfig,
    ) -> None:
        self.canvas, self.observed, self.lift, self.planar, self.render = canvas, observed, lift, planar, render
        self.decoders = analytic_decoders(planar.density, torch.Generator().manual_seed(0))
        self.tree = tree_by_need(canvas, planar.placement)
        self.places, areas = zip(*[_on_canvas(o, canvas) for o in self.observed], strict=True)
        # A pixel of a coarser observation stands for several of the canvas, and one of the margin counts less.
        self.weights = [1.0, *[planar.placement.margin_importance * area for area in areas[1:]]]
        inside = np.zeros(canvas.depth.shape, np.float32)
        inside[canvas.original] = 1.0
        self.edges = edge_error(canvas.image, canvas.depth, planar.placement) * inside

    def fit(
        self, cells: Cells, grid: PlanarGrid, colours: Float32Array | None, config: GrowthConfig, thinned: bool
    ) -> tuple[Float32Array, Residual]:
        """Colours [N, 3] and what remains.

        Thinned, for a first fit that only says where to split, it looks at one pixel of four where cells are of
        `_COARSE` pixels or more.
        """
        original, place = self.observed[0], self.places[0]
        kept, stands, nearest = np.arange(len(place)), np.ones(len(place)), np.arange(len(place))
        if thinned:
            kept, stands, nearest = self._thinned(cells)
            original = Observation(original.camera, original.rays[kept], original.colour[kept])
        view = linear_view(Renderer(self.lift(grid), self.decoders, self.render), original, *self.observed[1:])
        planar, steps = replace(self.planar, cg_steps=config.cg_steps), config.solver_steps * (2 if thinned else 1)
        colours, _, seen = refine(view, colours, planar, steps)
        lacking = view.target - np.clip(seen, 0, 1)
        squared = np.square(lacking).sum(1, dtype=np.float64)
        squared[: len(kept)] *= stands
        where = np.concatenate([place[kept], *self.places[1:]])
        image = self._painted(lacking[: len(kept)][np.searchsorted(kept, nearest)], lacking[len(kept) :])
        return colours, Residual(where, squared, len(kept), len(place), image)

    def _painted(self, original: Float32Array, margin: Float32Array) -> Float32Array:
        """What every ray lacks as an image of the canvas: of the original [P, 3], and of the margin's rays."""
        height, width = self.canvas.depth.shape
        image = np.zeros((height, width, 3), np.float32)
        for outer in self.observed[1:]:
            size = (outer.camera.height, outer.camera.width, 3)
            small = np.zeros((size[0] * size[1], 3), np.float32)
            small[outer.rays] = np.float32(math.sqrt(self.planar.placement.margin_importance)) * margin
            image[:] = cv2.resize(small.reshape(size), (width, height), interpolation=cv2.INTER_NEAREST)
        inner = image[self.canvas.original]
        inner[:] = original.reshape(inner.shape)
        return image

    def _thinned(self, cells: Cells) -> tuple[NDArray[np.int64], Float64Array, NDArray[np.int64]]:
        """Which rays of the original to keep, how many pixels each of them stands for, and who stands for each."""
        place, rays = self.places[0], self.observed[0].rays
        height, width = self.canvas.depth.shape
        coarse = cells.sizes[cell_of_pixel(cells, width, height).ravel()[place]] >= _COARSE
        across = self.observed[0].camera.width
        even = (rays % across % 2 == 0) & (rays // across % 2 == 0)
        (kept,) = np.nonzero(~coarse | even)
        share = int(coarse.sum()) / max(1, int(coarse[kept].sum()))
        nearest = np.where(coarse, rays // across // 2 * 2 * across + rays % across // 2 * 2, rays)
        return kept, np.where(coarse[kept], share, 1.0), nearest

    def merits(self, cells: Cells, residual: Residual) -> tuple[Float64Array, Float64Array]:
        """What splitting each cell promises, [N], zero for cells of one pixel; and what it should take off the input
        view's squared error. A cell across a depth edge promises more than it takes off."""
        height, width = self.canvas.depth.shape
        where, n = cell_of_pixel(cells, width, height).ravel(), len(cells.sizes)
        of_ray, share = where[residual.place], self.tree.shares(cells)
        weight = np.concatenate([np.full(len(p), w) for p, w in zip(self.places, self.weights, strict=True)])
        weight = weight[len(weight) - len(of_ray) :]  # of the original, whose weight is one, there may be fewer
        erring = np.bincount(of_ray, residual.squared * weight, n)
        edges = np.bincount(where, self.edges.ravel(), n)
        # Two estimates of what a split takes off: from the image alone (half of its logarithm is trusted, which ranks
        # best) and from what this fit lacks. Together they are better than either (measured).
        merit = np.sqrt(erring * np.sqrt(share) * captured(cells, residual.lacking)) + np.where(erring > 0, edges, 0)
        inside = slice(residual.inside)
        removed = np.bincount(of_ray[inside], residual.squared[inside], n) * share
        return np.asarray(np.where(cells.sizes > 1, merit, 0)), np.asarray(removed, np.float64)


def _on_canvas(observation: Observation, canvas: Canvas) -> tuple[Any, float]:
    """Canvas pixel (row-major) of each observed ray, and how many canvas pixels one of them covers."""
    height, width = canvas.depth.shape
    column = observation.rays % observation.camera.width + 0.5
    row = observation.rays // observation.camera.width + 0.5
    to, of = canvas.camera.K, observation.camera.K
    x = (column - of[0, 2]) / of[0, 0] * to[0, 0] + to[0, 2]
    y = (row - of[1, 2]) / of[1, 1] * to[1, 1] + to[1, 2]
    flat = np.clip(np.floor(y + 1e-6), 0, height - 1) * width + np.clip(np.floor(x + 1e-6), 0, width - 1)
    return flat.astype(np.int64), float(to[0, 0] / of[0, 0] * to[1, 1] / of[1, 1])
