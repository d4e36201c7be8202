"""How much of the novel views the method left empty."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bench.metrics.metric import MetricInput, MetricSpec, Score
from orca.errors import BadInput

__all__ = ["HoleFraction"]

COVERED = 0.5


class HoleFraction:
    """Share of pixels whose accumulated alpha is below one half, mean over the frames."""

    def specs(self, weights_dir: Path | None) -> tuple[MetricSpec, ...]:
        """The spec of `hole_fraction`."""
        variant = f"share of pixels with coverage < {COVERED:g} (NaN counts as empty), mean over frames"
        return (MetricSpec("hole_fraction", "Holes", False, (0.0, 1.0), variant, "bench 1", 4),)

    def compute(self, given: MetricInput) -> dict[str, Score]:
        """Score ``output.coverage``; no value where the method carries none. Raises `BadInput` for a wrong shape."""
        coverage, frames = given.output.coverage, given.output.frames
        if coverage is None:
            return {"hole_fraction": Score(None, 0, "decoded video carries no coverage")}
        if coverage.ndim != 3 or len(coverage) != len(frames):
            raise BadInput(
                f"coverage of shape {coverage.shape} for {len(frames)} frames",
                "[n, H, W], one map for each frame",
                "fix the adapter",
            )
        if coverage.size == 0:
            return {"hole_fraction": Score(None, 0, "no frames")}
        per_frame = tuple(float(np.mean(~(alpha >= COVERED))) for alpha in coverage)
        return {"hole_fraction": Score(float(np.mean(per_frame)), len(per_frame), None, per_frame)}
