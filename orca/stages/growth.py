"""Growth by residual: cells of the quadtree are split where the fit still errs, until something says stop.

Each round splits the cells with the largest squared error in the input view and the margin, and solves again from
the colours of the cells that they came from. It stops at the quality asked for, at the count allowed, when a thousand
more anchors gain less than their price, when there is nothing left to split, or by the paper's rule for iterations.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from orca.anchors import GaussianAnchors
from orca.config import GrowthConfig, PlanarConfig, RenderConfig
from orca.conventions import Float32Array, Float64Array
from orca.errors import BadInput
from orca.field.decoders import analytic_decoders
from orca.render.renderer import Renderer
from orca.stages.canvas import Canvas
from orca.stages.early_stopping import EarlyStopping
from orca.stages.linear import linear_view
from orca.stages.observations import Observation
from orca.stages.placement import Cells, cell_of_pixel, edge_error, split_cells
from orca.stages.planar import PlanarGrid, cells_by_need, grid_of
from orca.stages.solve import predicted, refine

__all__ = ["Growth", "GrowthStep", "grow"]

_SMALLEST_ROUND = 1.02  # a round that adds less than this share costs more than it gains


@dataclass(frozen=True)
class GrowthStep:
    """One round: how many anchors there are, how well they reproduce the input view, and the seconds so far."""

    anchors: int
    psnr_db: float
    seconds: float


@dataclass(frozen=True, eq=False)
class Growth:
    """What growing ended with.

    Attributes:
        grid: where the anchors sit.
        colours: colour logits that the last round solved for, [N, 3] float32.
        steps: every round, the start first.
        stopped: why no further round was made, in words.
    """

    grid: PlanarGrid
    colours: Float32Array
    steps: tuple[GrowthStep, ...]
    stopped: str

    def to_json(self) -> dict[str, Any]:
        """The curve and why it ends."""
        curve = [{"anchors": s.anchors, "psnr": s.psnr_db, "seconds": s.seconds} for s in self.steps]
        return {"stopped": self.stopped, "curve": curve}


def grow(
    canvas: Canvas,
    observed: Sequence[Observation],
    lift: Callable[[PlanarGrid], GaussianAnchors],
    planar: PlanarConfig,
    render: RenderConfig,
    config: GrowthConfig,
    progress: Callable[[int, int], None] | None = None,
) -> Growth:
    """Grow anchors from a content-driven start.

    Args:
        canvas: image, depth and margins.
        observed: the original, then the margin, if there is one; see `observations`.
        lift: anchors for a grid, where the fit is to be judged: on the plane, or at the scene's depth.
        planar: the closed-form fit's constants, and where the start's cells go.
        render: how rays meet anchors.
        config: when to stop.
        progress: called as progress(anchors, most).

    Raises:
        BadInput: fewer anchors are allowed than the coarsest cells are, or the fit is by gradient descent.
    """
    if planar.initialisation != "closed_form":
        raise BadInput("growth with a fit by gradient descent", "presets draft and quality", "choose another preset")
    rows, columns = canvas.original
    pixels = canvas.depth[rows, columns].size
    most = config.max_anchors or canvas.depth.size
    cells = cells_by_need(canvas, min(most, round(config.start_per_pixel * pixels)), planar.placement)
    if len(cells.sizes) > most:
        raise BadInput(
            f"at most {most} anchors", f"{len(cells.sizes)} or more for this picture and canvas", "allow more anchors"
        )
    fitter = _Fitter(canvas, observed, lift, planar, render)
    patience = EarlyStopping(config.min_gain_db, config.patience, smoothing=1.0)
    colours, steps, started = None, list[GrowthStep](), time.perf_counter()
    while True:
        grid = grid_of(canvas, cells)
        colours, error, psnr = fitter.fit(grid, colours, config.solver_steps * (1 if steps else 2))
        steps.append(GrowthStep(len(cells.sizes), psnr, time.perf_counter() - started))
        if progress is not None:
            progress(steps[-1].anchors, most)
        merit = fitter.merits(cells, error)
        add = _more(steps, most, config)
        stopped = _why(steps, most, config) or (None if merit.any() else "every cell with an error is one pixel")
        if stopped is None and patience.update(len(steps), psnr):
            stopped = f"{config.patience} rounds gained less than {config.min_gain_db:g} dB"
        if stopped is not None:
            return Growth(grid, colours, tuple(steps), stopped)
        chosen = _largest(merit, max(1, add // 3))
        cells, origin = split_cells(cells, chosen, canvas.depth.shape[1], canvas.depth.shape[0])
        colours = colours[origin]


def _why(steps: list[GrowthStep], most: int, config: GrowthConfig) -> str | None:
    """Why there is no further round, if so."""
    last = steps[-1]
    if config.target_psnr is not None and last.psnr_db >= config.target_psnr:
        return f"reached {config.target_psnr:g} dB"
    if config.max_anchors is not None and most - last.anchors < 3:
        return f"reached {most} anchors"
    if config.price is not None and len(steps) > 1:
        before = steps[-2]
        gain = (last.psnr_db - before.psnr_db) / (last.anchors - before.anchors) * 1000
        if gain < config.price:
            return f"a thousand anchors gained {gain:.3g} dB, less than their price of {config.price:g}"
    return None


def _more(steps: list[GrowthStep], most: int, config: GrowthConfig) -> int:
    """How many anchors the next round adds: the configured share, or as many as the target seems to need."""
    last, share = steps[-1], config.growth
    if config.target_psnr is not None and len(steps) > 1:
        before = steps[-2]
        slope = (last.psnr_db - before.psnr_db) / math.log(last.anchors / before.anchors)
        if slope > 0:
            needed = math.exp(min((config.target_psnr - last.psnr_db) / slope, 1.0))
            share = min(share, max(needed, _SMALLEST_ROUND))
    return min(round(last.anchors * (share - 1)), most - last.anchors)


def _largest(merit: Float64Array, count: int) -> Any:
    """Mask of the ``count`` largest merits that are not zero."""
    chosen = merit > 0
    if int(chosen.sum()) > count:
        order = np.argsort(-merit, kind="stable")[:count]
        chosen = np.zeros(len(merit), bool)
        chosen[order] = True
    return chosen


class _Fitter:
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
        weights = [1.0, *[planar.placement.margin_importance] * (len(self.observed) - 1)]
        places = [_on_canvas(o, canvas) for o in self.observed]
        self.pixel = np.concatenate([p for p, _ in places])
        # A pixel of a coarser observation stands for several of the canvas.
        self.weight = np.concatenate([np.full(len(p), w * a) for (p, a), w in zip(places, weights, strict=True)])
        placement, inside = planar.placement, np.zeros(canvas.depth.shape, np.float32)
        inside[canvas.original] = 1.0
        self.edges = edge_error(canvas.image, canvas.depth, placement) * inside

    def fit(
        self, grid: PlanarGrid, colours: Float32Array | None, steps: int
    ) -> tuple[Float32Array, Float64Array, float]:
        """Colours [N, 3], squared error of every observed ray [R], and PSNR of the input view in dB."""
        view = linear_view(Renderer(self.lift(grid), self.decoders, self.render), *self.observed)
        colours = refine(view, colours, self.planar, steps)
        error = np.square(np.clip(predicted(view, colours), 0, 1) - view.target).sum(1, dtype=np.float64)
        mean = float(error[: len(self.observed[0].rays)].mean()) / 3
        return colours, error, -10 * math.log10(max(mean, 1e-12))

    def merits(self, cells: Cells, error: Float64Array) -> Float64Array:
        """What each cell errs, [N]; zero for cells of one pixel. More where it crosses a depth edge."""
        height, width = self.canvas.depth.shape
        where, n = cell_of_pixel(cells, width, height), len(cells.sizes)
        merit = np.bincount(where.ravel()[self.pixel], error * self.weight, n)
        edges = np.bincount(where.ravel(), self.edges.ravel(), n)
        merit = merit + np.where(merit > 0, edges, 0)
        return np.asarray(np.where(cells.sizes > 1, merit, 0))


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
