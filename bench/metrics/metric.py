"""What a metric is: a frozen spec and a function of a method's output on one scene."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from bench.adapters.adapter import MethodOutput
from bench.datasets.case import SceneCase
from bench.metrics.llava_endpoint import LlavaEndpoint

__all__ = ["Configurable", "Metric", "MetricInput", "MetricOptions", "MetricSpec", "Score"]


@dataclass(frozen=True)
class MetricSpec:
    """What a score means, and what made it.

    Attributes:
        id: column name.
        title: heading with unit, for people.
        higher_is_better: direction of the arrow.
        bounds: smallest and largest possible value; None where there is no bound.
        variant: which definition ("known cameras, width 512").
        version: library and version that computes it.
        decimals: digits in a table.
        weights_sha256: hash of the weights used, if any.
    """

    id: str
    title: str
    higher_is_better: bool
    bounds: tuple[float | None, float | None]
    variant: str
    version: str
    decimals: int = 3
    weights_sha256: str | None = None


@dataclass(frozen=True, eq=False)
class MetricInput:
    """Everything a metric may look at.

    Attributes:
        case: the scene.
        output: the method's frames.
        weights_dir: folder with downloaded weights, or None.
        device: "cpu" or "cuda".
    """

    case: SceneCase
    output: MethodOutput
    weights_dir: Path | None = None
    device: str = "cpu"


@dataclass(frozen=True)
class MetricOptions:
    """What a user chose about metrics, beside the folder of weights.

    Attributes:
        llava: the server that answers LLaVA-IQA's questions; None for the model on this machine.
        answers: file of the raw answers of language models; None to keep them in memory only.
    """

    llava: LlavaEndpoint | None = None
    answers: Path | None = None


@dataclass(frozen=True)
class Score:
    """One value of one metric on one scene.

    Attributes:
        value: the score, always finite; None when there is none, and then ``reason`` says why.
        n: how many frames, pairs or views it was averaged over.
        reason: why there is no value ("no true view in this data set"); None when there is one.
        per_frame: the values that were averaged (None for a frame without one).
        detail: everything else worth keeping (curves, nulls, counts); JSON-ready.
    """

    value: float | None
    n: int
    reason: str | None = None
    per_frame: tuple[float | None, ...] | None = None
    detail: dict[str, Any] = field(default_factory=dict)


class Metric(Protocol):
    """A metric family: may yield several scores at once (TSED and its median come from the same matches)."""

    def specs(self, weights_dir: Path | None) -> tuple[MetricSpec, ...]:
        """The specs of all scores this object computes, weights hash included."""
        ...

    def compute(self, given: MetricInput) -> dict[str, Score]:
        """Scores by metric id. Raises `Unavailable` when weights are missing: the run goes on with n/a."""
        ...


@runtime_checkable
class Configurable(Protocol):
    """A metric that has options: told of them once, before anything else is asked of it."""

    def configure(self, options: MetricOptions) -> None:
        """Take the options."""
        ...
