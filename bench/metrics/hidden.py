"""Where a method puts what was hidden: with the background, or with what stood in front of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bench.datasets.case import TrueView
from bench.metrics.metric import MetricInput, MetricSpec, Score
from orca.conventions import Float32Array

__all__ = ["HiddenDepth"]

FILLED = 0.5


class HiddenDepth:
    """Share of filled hidden pixels whose depth is nearer to the true one than to that of what hid it."""

    def specs(self, weights_dir: Path | None) -> tuple[MetricSpec, ...]:
        """The spec of `hidden_depth`."""
        variant = (
            f"hidden pixels with coverage >= {FILLED:g} whose occluder is another object; "
            "|z - true| < |z - occluder|; pooled over true views"
        )
        return (MetricSpec("hidden_depth", "Hidden depth right", True, (0.0, 1.0), variant, "bench 1", 3),)

    def compute(self, given: MetricInput) -> dict[str, Score]:
        """Score ``output.true_view_depth``; no value where truth or method carries no depth."""
        return {"hidden_depth": _score(given)}


def _score(given: MetricInput) -> Score:
    views, output = given.case.true_views, given.output
    if not views or any(view.depth is None or view.occluder_depth is None for view in views):
        return Score(None, 0, "no true depth of hidden pixels in this data set")
    if output.true_view_depth is None or output.true_view_coverage is None:
        return Score(None, 0, "the method has no depth at the true views")
    counts = [
        _right_of(view, depth, alpha)
        for view, depth, alpha in zip(views, output.true_view_depth, output.true_view_coverage, strict=True)
    ]
    right, filled, judged = (sum(column) for column in zip(*counts, strict=True))
    detail = {"judged": judged, "filled": filled, "right": right}
    if filled == 0:
        return Score(None, 0, "no hidden pixel is filled", None, detail)
    per_view = tuple(r / f if f else None for r, f, _ in counts)
    return Score(right / filled, len(views), None, per_view, detail)


def _right_of(view: TrueView, depth: Float32Array, alpha: Float32Array) -> tuple[int, int, int]:
    """How many hidden pixels are right, filled, and judged at all."""
    true, occluder = np.asarray(view.depth, np.float32), np.asarray(view.occluder_depth, np.float32)
    judged = view.hidden & np.isfinite(occluder) & np.isfinite(true)
    filled = judged & (alpha >= FILLED) & (depth > 0)
    right = filled & (np.abs(depth - true) < np.abs(depth - occluder))
    return int(right.sum()), int(filled.sum()), int(judged.sum())
