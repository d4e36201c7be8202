"""What a run is asked to do."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench.adapters.adapter import RunOptions
from bench.codec import CODEC
from bench.datasets.case import Dataset
from bench.metrics.metric import MetricOptions
from bench.plan import IDENTITY

__all__ = ["RunRequest"]


@dataclass(frozen=True)
class RunRequest:
    """What to run.

    Attributes:
        dataset: where the scenes come from.
        scenes: names, in running order; each must be one of ``dataset.scenes()``.
        methods: method names, or ``NAME=KIND:PATH`` (`bench.adapters.external`).
        metrics: metric ids.
        out: folder of the run.
        options: preset, seed, device and folders, as adapters see them.
        images: folder of images, for the data set that needs one.
        trajectory: name of the path, or None for the data set's own.
        retry_failed: run what failed again.
        command: the command line, for the caption.
        preset_config: the resolved preset, kept beside the results.
        argv: the command line as it was given, word by word.
        codec_match: score every method's pictures after `bench.codec`.
        score_cache: folder of scores by content; None for the run's own.
        metric_options: what the user chose about metrics; the file of answers is the run's own.
        cell_timeout: seconds that loading a scene, a method, and each metric family may take; None for no limit.
    """

    dataset: Dataset
    scenes: tuple[str, ...]
    methods: tuple[str, ...]
    metrics: tuple[str, ...]
    out: Path
    options: RunOptions = field(default_factory=RunOptions)
    images: Path | None = None
    trajectory: str | None = None
    retry_failed: bool = False
    command: str = ""
    preset_config: dict[str, Any] = field(default_factory=dict)
    argv: tuple[str, ...] = ()
    codec_match: bool = False
    score_cache: Path | None = None
    metric_options: MetricOptions = field(default_factory=MetricOptions)
    cell_timeout: float | None = None

    @property
    def identity(self) -> dict[str, Any]:
        """What may not change between two runs into one folder."""
        values = {
            "dataset": self.dataset.name,
            "images": None if self.images is None else str(Path(self.images).resolve()),
            "trajectory": self.trajectory,
            "preset": self.options.preset,
            "seed": self.options.seed,
            "device": self.options.device,
            "codec": CODEC if self.codec_match else None,
        }
        return {name: values[name] for name in IDENTITY}
