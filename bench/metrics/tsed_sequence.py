"""TSED of a sequence: consecutive pairs, the curve over thresholds, and the nulls that say what the score can tell."""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from bench.metrics.epipolar import largest_center_norm
from bench.metrics.estimated import epipolar_inliers
from bench.metrics.matching import match_descriptors
from bench.metrics.sift import Features, detect_all
from bench.metrics.tsed_config import TsedConfig
from bench.metrics.tsed_pair import PairMatches, PairScore, judge_estimated, judge_known
from orca.camera import Camera
from orca.conventions import UInt8Array
from orca.errors import BadInput

__all__ = ["SequenceScore", "consistent_fraction", "judge_pairs", "match_consecutive", "score_sequence"]


@dataclass(frozen=True)
class SequenceScore:
    """Verdicts on the consecutive pairs of one sequence.

    Attributes:
        config: the settings.
        width: frame width, pixels.
        pairs: pair i is of frames i and i + 1.
        flows: median displacement of each pair's matches, pixels; None without a match.
        frozen: the same pairs with x2 := x1, what a frozen video would score.
        shifted: pair i judged by the cameras of pair i + 1 (one fewer); empty with estimated geometry.
    """

    config: TsedConfig
    width: int
    pairs: tuple[PairScore, ...]
    flows: tuple[float | None, ...]
    frozen: tuple[PairScore, ...]
    shifted: tuple[PairScore, ...] = field(default=())

    @property
    def t_error(self) -> float:
        """The score's distance threshold in pixels of the frames."""
        return self.config.t_error * self.width / (self.config.t_error_width or self.width)

    def tsed(self, pairs: Sequence[PairScore] | None = None) -> float | None:
        """Share of consistent pairs at the score's thresholds (of ``pairs``, for the nulls); None without a pair."""
        return consistent_fraction(self.pairs if pairs is None else pairs, self.t_error, self.config.t_matches)

    @property
    def median_sed(self) -> float | None:
        """Median over the pairs of each pair's median distance, pixels.

        A pair without a match counts as infinitely far; None where the median is infinite, or there is no pair.
        """
        medians = [pair.median for pair in self.pairs if not pair.excluded]
        value = float(np.median(medians)) if medians else math.inf
        return value if math.isfinite(value) else None

    @property
    def median_flow(self) -> float | None:
        """Median over the pairs of each pair's median displacement, pixels."""
        flows = [flow for flow in self.flows if flow is not None]
        return float(np.median(flows)) if flows else None

    def curve(self) -> list[dict[str, Any]]:
        """TSED and both nulls over the grid of thresholds, at the frames' width and at ``curve_width``."""
        rows = []
        for width in dict.fromkeys((self.width, self.config.curve_width)):
            for t_matches in self.config.curve_matches:
                for t_error in self.config.curve_errors:
                    here = t_error * self.width / width
                    row: dict[str, Any] = {"t_error": t_error, "t_matches": t_matches, "t_error_width": width}
                    row["tsed"] = consistent_fraction(self.pairs, here, t_matches)
                    row["frozen_null"] = consistent_fraction(self.frozen, here, t_matches)
                    row["shifted_camera_null"] = consistent_fraction(self.shifted, here, t_matches)
                    rows.append(row)
        return rows

    def powerless_against(self) -> tuple[str, ...]:
        """The nulls that the score is within ``null_margin`` of: at this step size it cannot tell them apart."""
        score = self.tsed()
        nulls = {"frozen": self.tsed(self.frozen), "shifted_camera": self.tsed(self.shifted)}
        # The allowance keeps 0.95 against 1.00 inside a margin of 0.05, whatever the last bit.
        margin = self.config.null_margin + 1e-9
        near = [k for k, v in nulls.items() if score is not None and v is not None and abs(score - v) <= margin]
        return tuple(near)


def consistent_fraction(pairs: Sequence[PairScore], t_error: float, t_matches: int) -> float | None:
    """Consistent / counted pairs; excluded pairs are not counted; None when none is left.

    Args:
        pairs: the verdicts.
        t_error: distance threshold in pixels of the frames, strict.
        t_matches: least number of matches.
    """
    counted = [pair for pair in pairs if not pair.excluded]
    return sum(pair.ok(t_error, t_matches) for pair in counted) / len(counted) if counted else None


def match_consecutive(frames: UInt8Array, config: TsedConfig, threads: int = 2) -> tuple[PairMatches, ...]:
    """Matches of frames i and i + 1, every frame detected once; the same for any number of threads.

    Args:
        frames: [n, H, W, 3] uint8.
        config: detector, matcher and prefilter settings.
        threads: worker threads.
    """
    features = detect_all(tuple(frames), config.sift, threads)

    def match(pair: tuple[Features, Features]) -> PairMatches:
        first, second = pair
        i, j = match_descriptors(first.descriptors, second.descriptors, config.matcher)
        matches = PairMatches(first.points[i], second.points[j])
        if not config.ransac_prefilter:
            return matches
        kept = epipolar_inliers(matches.x1, matches.x2, config.estimator)
        return PairMatches(matches.x1[kept], matches.x2[kept])

    with ThreadPoolExecutor(max_workers=max(1, threads)) as pool:
        return tuple(pool.map(match, pairwise(features)))


def judge_pairs(
    matches: Sequence[PairMatches], cameras: Sequence[Camera], config: TsedConfig, shift: int = 0
) -> tuple[PairScore, ...]:
    """Judge pair i by cameras i + shift and i + shift + 1; pairs beyond the last camera are dropped."""
    if config.mode == "estimated":
        return tuple(judge_estimated(pair, config) for pair in matches)
    extent = largest_center_norm(tuple(cameras))
    geometry = zip(matches, cameras[shift:], cameras[shift + 1 :], strict=False)
    return tuple(judge_known(pair, first, second, extent, config) for pair, first, second in geometry)


def score_sequence(
    frames: UInt8Array, cameras: Sequence[Camera], config: TsedConfig | None = None, threads: int = 2
) -> SequenceScore:
    """Score a sequence of frames at their cameras.

    Args:
        frames: [n, H, W, 3] uint8.
        cameras: one a frame, brought to the frames' size with `Camera.resized`; not looked at in mode "estimated".
        config: settings; the reference's when left out.
        threads: worker threads; the result does not depend on them.

    Raises:
        BadInput: for other than uint8 [n, H, W, 3], or another number of cameras than of frames.
    """
    c = config or TsedConfig()
    if frames.ndim != 4 or frames.shape[3] != 3 or frames.dtype != np.uint8:
        raise BadInput(f"frames of shape {frames.shape}, {frames.dtype}", "uint8 [n, H, W, 3]", "fix the adapter")
    if len(cameras) != len(frames):
        raise BadInput(
            f"{len(frames)} frames for {len(cameras)} cameras", "one frame for each camera", "render every camera"
        )
    height, width = frames.shape[1:3]
    sized = [camera.resized(width, height) for camera in cameras]
    matches = match_consecutive(frames, c, threads)
    return SequenceScore(
        config=c,
        width=width,
        pairs=judge_pairs(matches, sized, c),
        flows=tuple(pair.flow for pair in matches),
        frozen=judge_pairs([pair.frozen() for pair in matches], sized, c),
        shifted=() if c.mode == "estimated" else judge_pairs(matches, sized, c, shift=1),
    )
