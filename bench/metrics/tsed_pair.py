"""One pair of frames: its matches, the geometry that judges them, and the verdict."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from bench.metrics.epipolar import (
    fundamental_matrix,
    homography_transfer_distance,
    infinite_homography,
    is_zero_baseline,
    symmetric_epipolar_distance,
)
from bench.metrics.estimated import estimate_model
from bench.metrics.tsed_config import TsedConfig
from orca.camera import Camera
from orca.conventions import Float64Array

__all__ = ["PairMatches", "PairScore", "Refusal", "judge_estimated", "judge_known", "median_distance"]

Refusal = Literal["few_matches", "sed", "zero_baseline", "low_inliers", "no_model"]


@dataclass(frozen=True, eq=False)
class PairMatches:
    """Matched pixels of two frames.

    Attributes:
        x1: in the first frame, [n, 2] float64.
        x2: in the second, [n, 2] float64.
    """

    x1: Float64Array
    x2: Float64Array

    def __len__(self) -> int:
        return len(self.x1)

    def frozen(self) -> PairMatches:
        """The same matches had the second frame been a copy of the first: x2 := x1."""
        return PairMatches(self.x1, self.x1)

    @property
    def flow(self) -> float | None:
        """Median |x2 - x1|, pixels; None without a match."""
        return float(np.median(np.linalg.norm(self.x2 - self.x1, axis=1))) if len(self) else None


@dataclass(frozen=True)
class PairScore:
    """The verdict on one pair.

    Attributes:
        n: number of matches.
        median: median distance of the matches to the model, pixels; inf where there is none.
        model: "F" (epipolar lines), "H" (one camera centre, or a homography that explains the matches), or None.
        obstacle: why the pair fails whatever the thresholds ("zero_baseline", "low_inliers", "no_model"), or None.
        excluded: True if the pair is left out of the score.
        inlier_ratio: of an estimated model; None with known cameras.
        min_matches: smallest number of matches that the model can be trusted with, whatever ``t_matches``.
    """

    n: int
    median: float
    model: Literal["F", "H"] | None
    obstacle: Refusal | None = None
    excluded: bool = False
    inlier_ratio: float | None = None
    min_matches: int = 0

    def reason(self, t_error: float, t_matches: int) -> Refusal | None:
        """Why the pair is not consistent: n >= t_matches and median < t_error are needed; None if it is."""
        if self.n < max(t_matches, self.min_matches):
            return "few_matches"
        if self.obstacle is not None:
            return self.obstacle
        return None if self.median < t_error else "sed"

    def ok(self, t_error: float, t_matches: int) -> bool:
        """True if the pair is consistent."""
        return not self.excluded and self.reason(t_error, t_matches) is None

    def to_json(self, t_error: float, t_matches: int) -> dict[str, Any]:
        """Plain data; an infinite median is the string "inf", and null without a match."""
        finite = np.isfinite(self.median)
        return {
            "n": self.n,
            "median": self.median if finite else ("inf" if self.n else None),
            "ok": self.ok(t_error, t_matches),
            "reason": self.reason(t_error, t_matches),
            "model": self.model,
            "excluded": self.excluded,
            "inlier_ratio": self.inlier_ratio,
        }


def median_distance(distance: Float64Array) -> float:
    """Median of distances in [0, inf] (an even count averages the middle two); inf when empty."""
    return float(np.median(distance)) if len(distance) else float("inf")


def judge_known(
    matches: PairMatches, first: Camera, second: Camera, extent: float, config: TsedConfig | None = None
) -> PairScore:
    """Judge a pair by its cameras: median symmetric epipolar distance over all matches, no RANSAC.

    Args:
        matches: the pair's matches.
        first, second: the cameras, in pixels of the frames.
        extent: max |C| of the sequence, against which a baseline counts as zero.
        config: settings; the reference's when left out.
    """
    c = config or TsedConfig()
    if not is_zero_baseline(first, second, extent):
        distance = symmetric_epipolar_distance(fundamental_matrix(first, second), matches.x1, matches.x2)
        return PairScore(len(matches), median_distance(distance), "F")
    if c.zero_baseline == "homography":
        distance = homography_transfer_distance(infinite_homography(first, second), matches.x1, matches.x2)
        return PairScore(len(matches), median_distance(distance), "H")
    # Without a baseline F is zero and every distance 0/0: inconsistent in the reference.
    return PairScore(len(matches), float("inf"), None, "zero_baseline", excluded=c.zero_baseline == "exclude")


def judge_estimated(matches: PairMatches, config: TsedConfig | None = None) -> PairScore:
    """Judge a pair by the model that its own matches suggest: self-consistency, blind to wrong cameras."""
    e = (config or TsedConfig(mode="estimated")).estimator
    model = estimate_model(matches.x1, matches.x2, e)
    if model is None:
        return PairScore(len(matches), float("inf"), None, "no_model", min_matches=e.min_matches)
    low = model.inlier_ratio < e.min_inlier_ratio
    return PairScore(
        n=len(matches),
        median=median_distance(model.distance),
        model=model.name,
        obstacle="low_inliers" if low else None,
        inlier_ratio=model.inlier_ratio,
    )
