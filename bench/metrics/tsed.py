"""TSED and the median symmetric epipolar distance as scores of the bench."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2

from bench.metrics.metric import MetricInput, MetricSpec, Score
from bench.metrics.tsed_config import TsedConfig
from bench.metrics.tsed_sequence import SequenceScore, score_sequence

__all__ = ["NO_POWER", "EpipolarSelfConsistency", "Tsed", "sequence_scores"]

NO_POWER = "no power at this step size"


class Tsed:
    """Thresholded symmetric epipolar distance (Yu et al., ICCV 2023) between consecutive frames.

    With known cameras the scores are `tsed` and `tsed_median_sed`; with estimated geometry they measure something else
    and are named `epipolar_self_consistency` and `epipolar_self_consistency_median_sed`.

    Args:
        config: settings; the reference's, with known cameras, when left out.
        threads: worker threads; the scores do not depend on them.
    """

    def __init__(self, config: TsedConfig | None = None, threads: int = 2) -> None:
        self.config, self.threads = config or TsedConfig(), threads
        self.id = "tsed" if self.config.mode == "known" else "epipolar_self_consistency"

    def specs(self, weights_dir: Path | None) -> tuple[MetricSpec, ...]:
        """The specs of the fraction and of the median distance."""
        c = self.config
        title = "TSED" if c.mode == "known" else "Epipolar self-consistency"
        # The hash makes a stored score of other settings a stale one.
        version = f"bench 1, OpenCV {cv2.__version__}, settings {c.sha256[:8]}"
        at = "native width" if c.t_error_width is None else f"width {c.t_error_width}"
        geometry = _geometry(c)
        thresholds = f"median < {c.t_error:g} px at {at}, n >= {c.t_matches}"
        return (
            MetricSpec(self.id, title, True, (0.0, 1.0), f"{geometry}, {thresholds}", version, 3),
            MetricSpec(
                f"{self.id}_median_sed",
                "Median SED [px]",
                False,
                (0.0, None),
                f"{geometry}, native width, median over pairs of the pair's median",
                version,
                3,
            ),
        )

    def compute(self, given: MetricInput) -> dict[str, Score]:
        """Score the frames at the cameras of ``case.eval_trajectory``; raises `BadInput` if they do not fit."""
        cameras = given.case.eval_trajectory.cameras()
        frames = given.output.frames
        if len(frames) < 2 and len(frames) == len(cameras):
            few = Score(None, 0, "fewer than two frames")
            return {self.id: few, f"{self.id}_median_sed": few}
        sequence = score_sequence(frames, cameras, self.config, self.threads)
        return sequence_scores(sequence, frames.shape[1], self.id)


def sequence_scores(sequence: SequenceScore, height: int, name: str) -> dict[str, Score]:
    """The fraction under ``name`` and the median distance under ``name``_median_sed, with all detail.

    Args:
        sequence: the verdicts.
        height: of the frames, pixels, for the record.
        name: id of the fraction.
    """
    return {name: _fraction(sequence, height), f"{name}_median_sed": _median(sequence)}


class EpipolarSelfConsistency(Tsed):
    """The estimated mode with its settings at their defaults, as the registry knows it."""

    def __init__(self, threads: int = 2) -> None:
        super().__init__(TsedConfig(mode="estimated"), threads)


def _geometry(config: TsedConfig) -> str:
    if config.mode == "estimated":
        return f"F or H estimated from the matches (MAGSAC), RootSIFT, mutual ratio {config.matcher.ratio:g}"
    note = ", RANSAC-prefiltered matches" if config.ransac_prefilter else ""
    zero = "" if config.zero_baseline == "homography" else f", zero baseline: {config.zero_baseline}"
    return f"known cameras, RootSIFT, mutual ratio {config.matcher.ratio:g}{note}{zero}"


def _fraction(sequence: SequenceScore, height: int) -> Score:
    c = sequence.config
    value = sequence.tsed()
    per_pair = tuple(None if p.excluded else float(p.ok(sequence.t_error, c.t_matches)) for p in sequence.pairs)
    counted = sum(not pair.excluded for pair in sequence.pairs)
    powerless = sequence.powerless_against()
    detail: dict[str, Any] = {
        "mode": c.mode,
        "consistent": sum(pair == 1.0 for pair in per_pair),
        "pairs": _pairs(sequence),
        "curve": sequence.curve(),
        "frozen_null": sequence.tsed(sequence.frozen),
        "shifted_camera_null": sequence.tsed(sequence.shifted),
        "powerless_against": list(powerless),
        "warning": f"{NO_POWER} against: {', '.join(powerless)}" if powerless else None,
        "median_sed": sequence.median_sed,
        "median_flow": sequence.median_flow,
        "width": sequence.width,
        "height": height,
        "t_error_width": c.t_error_width or sequence.width,
        "ransac_prefilter": c.ransac_prefilter,
        "config": c.to_json(),
        "config_sha256": c.sha256,
        "opencv": cv2.__version__,
    }
    reason = None if value is not None else "every pair has a zero baseline and is excluded"
    return Score(value, counted, reason, per_pair, detail)


def _median(sequence: SequenceScore) -> Score:
    medians = tuple(None if p.excluded or p.median == float("inf") else p.median for p in sequence.pairs)
    counted = sum(not pair.excluded for pair in sequence.pairs)
    value = sequence.median_sed
    normalised = None if value is None else value * sequence.config.curve_width / sequence.width
    detail: dict[str, Any] = {
        "median_flow": sequence.median_flow,
        "pairs_without_value": sum(m is None for m in medians),
        f"at_width_{sequence.config.curve_width}": normalised,
        "config_sha256": sequence.config.sha256,
    }
    reason = None if value is not None else "at least half of the pairs have no finite distance (no matches)"
    return Score(value, counted, reason, medians, detail)


def _pairs(sequence: SequenceScore) -> list[dict[str, Any]]:
    c = sequence.config
    return [
        {"frames": [i, i + 1], **pair.to_json(sequence.t_error, c.t_matches), "flow": flow}
        for i, (pair, flow) in enumerate(zip(sequence.pairs, sequence.flows, strict=True))
    ]
