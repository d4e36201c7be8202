"""Growth by residual: cells of the quadtree are split where the fit still errs, until something says stop.

It starts from the quadtree that should come near the end: its own error, known before any fit, predicts that of a fit.
Each round splits the cells whose errors in the input view and the margin promise most for an anchor, and solves again
from the colours of the cells that they came from. It stops at the quality asked for, at the count allowed, when a
thousand more anchors gain less than their price, when there is nothing left to split, or by the paper's rule for
iterations.
"""

from __future__ import annotations

import math
import time
from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orca.anchors import GaussianAnchors
from orca.config import GrowthConfig, PlanarConfig, RenderConfig
from orca.conventions import Float32Array, Float64Array
from orca.errors import BadInput
from orca.stages.allowance import Allowance
from orca.stages.canvas import Canvas
from orca.stages.early_stopping import EarlyStopping
from orca.stages.observations import Observation
from orca.stages.placement import Cells, split_cells
from orca.stages.planar import PlanarGrid, grid_of
from orca.stages.residual import Fitter, Residual, psnr_of, squared_of

__all__ = ["Growth", "GrowthStep", "grow"]

_SMALLEST_ROUND = 1.02  # a round that adds less than this share costs more than it gains
_STEP = 1.1  # between counts that the start is chosen from
_FIT_GAIN = 1.0  # dB that a fit is better than interpolation between the quadtree's cells, at least
_BEYOND = 0.45  # dB beyond the target that a round aims at: to fall short costs another round


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
        """The curve and why it ends, without its seconds: what a scene is does not depend on the clock."""
        curve = [{"anchors": s.anchors, "psnr": s.psnr_db} for s in self.steps]
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
    fitter = Fitter(canvas, observed, lift, planar, render)
    allowed = Allowance.of(canvas, config)
    cells = fitter.tree.cells(_start(fitter, allowed.most, config))
    allowed = allowed.at_least(cells)
    patience = EarlyStopping(config.min_gain_db, config.patience, smoothing=1.0)
    colours, steps, started = None, list[GrowthStep](), time.perf_counter()
    thinned = True
    while True:
        grid = grid_of(canvas, cells)
        colours, residual = fitter.fit(cells, grid, colours, config, thinned)
        steps.append(GrowthStep(len(cells.sizes), residual.psnr_db, time.perf_counter() - started))
        if progress is not None:
            progress(steps[-1].anchors, allowed.most)
        stopped, chosen = _why(steps, cells, allowed, config), None
        if stopped is None and patience.update(len(steps), residual.psnr_db):
            stopped = f"{config.patience} rounds gained less than {config.min_gain_db:g} dB"
        if stopped is None:
            chosen = _chosen(fitter, cells, residual, allowed, config)
            stopped = None if chosen.any() else "every cell with an error is one pixel"
        if chosen is not None and stopped is None:
            cells, origin = split_cells(cells, chosen, canvas.depth.shape[1], canvas.depth.shape[0])
            colours = colours[origin]
        elif not thinned:
            return Growth(grid, colours, tuple(steps), stopped or "")
        else:  # by some of the rays only: all of them must say so
            steps.pop()
        thinned = False


def _start(fitter: Fitter, most: int, config: GrowthConfig) -> int:
    """How many anchors to begin with: a share of the count allowed, or of what should do by the quadtree's error."""
    tree, pixels = fitter.tree, len(fitter.observed[0].rays)
    count = config.start * most if _limited(config) else float(most)
    series = _series(tree.fewest, most)
    if config.target_psnr is not None:
        enough = squared_of(config.target_psnr - _FIT_GAIN, pixels)
        at = bisect_left(series, -enough, key=lambda n: -tree.error(n))
        count = min(count, config.start_target * series[min(at, len(series) - 1)])
    if config.price is not None:
        scores = [psnr_of(tree.error(n), pixels) for n in series]
        rates = [(b - a) / (n - m) * 1000 for a, b, m, n in zip(scores, scores[1:], series, series[1:], strict=False)]
        dear = next((n for n, rate in zip(series[1:], rates, strict=True) if rate < config.price), most)
        count = min(count, config.start_target * dear)
    return int(max(tree.fewest, min(most, round(count))))


def _limited(config: GrowthConfig) -> bool:
    """Whether a count is given."""
    return config.max_anchors is not None or config.max_inside is not None


def _series(low: int, high: int) -> list[int]:
    """Counts from ``low`` to ``high``, each `_STEP` times the one before."""
    steps = math.ceil(math.log(max(high / low, 1)) / math.log(_STEP))
    return [*(round(low * _STEP**i) for i in range(steps)), max(low, high)]


def _why(steps: list[GrowthStep], cells: Cells, allowed: Allowance, config: GrowthConfig) -> str | None:
    """Why there is no further round, if so."""
    last = steps[-1]
    if config.target_psnr is not None and last.psnr_db >= config.target_psnr:
        return f"reached {config.target_psnr:g} dB"
    if _limited(config) and allowed.full(cells):
        return allowed.words
    if config.price is not None and len(steps) > 1:
        before = steps[-2]
        gain = (last.psnr_db - before.psnr_db) / (last.anchors - before.anchors) * 1000
        if gain < config.price:
            return f"a thousand anchors gained {gain:.3g} dB, less than their price of {config.price:g}"
    return None


def _chosen(
    fitter: Fitter, cells: Cells, residual: Residual, allowed: Allowance, config: GrowthConfig
) -> NDArray[np.bool_]:
    """Which cells to split next, [N]: those that promise most."""
    merit, removed = fitter.merits(cells, residual)
    order = np.argsort(-merit, kind="stable")[: np.count_nonzero(merit)]
    return allowed.chosen(cells, order, _splits(allowed.count(cells), removed[order], residual, allowed.most, config))


def _splits(count: int, removed: Float64Array, residual: Residual, most: int, config: GrowthConfig) -> int:
    """How many splits the next round makes: so many that the rounds to the count allowed are alike, or fewer if the
    target should need no more; ``removed``: squared error that each split should remove, in the order they are made.
    """
    ratio = config.growth_open
    if _limited(config):
        ratio = config.growth
        left = most / count
        ratio = left ** (1 / max(1, math.ceil(math.log(left) / math.log(ratio) - 1e-9)))
    if config.target_psnr is None:
        return math.ceil(count * (ratio - 1) / 3 - 1e-9)
    excess = residual.original - squared_of(config.target_psnr + _BEYOND, residual.pixels)
    needed = int(np.searchsorted(np.cumsum(removed), excess)) + 1
    # A round that knows what it needs may be as long as two, and none is too short to be worth it.
    fewest, longest = (int(count * (share - 1)) // 3 for share in (_SMALLEST_ROUND, ratio**2))
    return int(min(longest, max(needed, fewest)))
