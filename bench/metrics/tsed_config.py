"""Every choice that a TSED number depends on, in one place, with a hash."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, field
from typing import Any, Literal, get_args

from bench.metrics.estimated import EstimatorConfig
from bench.metrics.matching import MatchConfig
from bench.metrics.sift import SiftConfig
from orca.errors import BadInput

__all__ = ["Mode", "TsedConfig", "ZeroBaseline"]

Mode = Literal["known", "estimated"]
ZeroBaseline = Literal["homography", "reference", "exclude"]


@dataclass(frozen=True)
class TsedConfig:
    """How consecutive frames are matched and judged (TSED: Yu et al., ICCV 2023, and its reference code).

    Attributes:
        mode: "known" judges matches by the given cameras (the reference); "estimated" by a model fitted to the matches
            (epipolar self-consistency: another quantity, under another name).
        t_error: the pair's median distance must be strictly below this, pixels at ``t_error_width``.
        t_matches: least number of matches of a consistent pair.
        t_error_width: image width in which ``t_error`` is meant; None: the width of the frames.
        curve_errors: thresholds of the reported curve, pixels.
        curve_matches: match counts of the reported curve.
        curve_width: the second width of the curve, beside the frames' own.
        zero_baseline: pairs of one camera centre are judged by the exact homography ("homography"), are inconsistent
            ("reference"), or are left out ("exclude").
        ransac_prefilter: known cameras, but only the inliers of an estimated F: hides errors, for comparison only.
        null_margin: a score this close to a null has no power.
        sift, matcher, estimator: settings of the stages.
    """

    mode: Mode = "known"
    t_error: float = 2.0
    t_matches: int = 10
    t_error_width: int | None = None
    curve_errors: tuple[float, ...] = (0.5, 1.0, 2.0, 4.0)
    curve_matches: tuple[int, ...] = (10, 15)
    curve_width: int = 256
    zero_baseline: ZeroBaseline = "homography"
    ransac_prefilter: bool = False
    null_margin: float = 0.05
    sift: SiftConfig = field(default_factory=SiftConfig)
    matcher: MatchConfig = field(default_factory=MatchConfig)
    estimator: EstimatorConfig = field(default_factory=EstimatorConfig)

    def __post_init__(self) -> None:
        _one_of("mode", self.mode, get_args(Mode))
        _one_of("zero_baseline", self.zero_baseline, get_args(ZeroBaseline))
        widths = (self.curve_width, 1 if self.t_error_width is None else self.t_error_width)
        if min(self.t_error, *self.curve_errors) <= 0 or min(self.t_matches, *self.curve_matches, *widths) < 1:
            raise BadInput(
                f"TSED thresholds {self.t_error:g} px, {self.t_matches} matches, curve {self.curve_errors} px, "
                f"{self.curve_matches} matches, widths {widths}",
                "positive distances, and counts and widths of at least 1",
                "correct the TSED settings",
            )
        if self.mode == "estimated" and self.ransac_prefilter:
            raise BadInput(
                "ransac_prefilter with estimated geometry",
                "the prefilter only with mode 'known'",
                "leave one of the two out",
            )

    def to_json(self) -> dict[str, Any]:
        """Plain data, every field."""
        document: dict[str, Any] = json.loads(json.dumps(asdict(self)))
        return document

    @property
    def sha256(self) -> str:
        """Hash of all settings."""
        return hashlib.sha256(json.dumps(self.to_json(), sort_keys=True).encode()).hexdigest()


def _one_of(name: str, given: str, allowed: tuple[str, ...]) -> None:
    if given not in allowed:
        raise BadInput(f"TSED {name} '{given}'", ", ".join(allowed), f"choose one {name} of the list")
