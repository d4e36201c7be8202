"""The metric `niqe`: a no-reference score that runs with one small prior file and no network."""

from __future__ import annotations

from pathlib import Path

from bench.metrics.metric import MetricInput, MetricSpec, Score
from bench.metrics.natural_statistics import BLOCK, NiqePrior, niqe
from bench.metrics.per_frame import mean_over_frames
from bench.metrics.weights import WeightsFile

__all__ = ["NIQE_PRIOR", "Niqe"]

# Of the hash only these digits are on record: the publisher states none.
NIQE_PRIOR = WeightsFile(
    "niqe",
    "niqe_modelparameters.mat",
    "https://huggingface.co/chaofengc/IQA-PyTorch-Weights",
    "fa2aa4d12dd9595c",
)
NO_VALUE = f"flat, or fewer than two whole blocks of {BLOCK}x{BLOCK} pixels"


class Niqe:
    """Distance of a frame's natural-scene statistics from those of pristine photographs; lower is better."""

    def __init__(self) -> None:
        self._loaded: tuple[Path, NiqePrior] | None = None

    def specs(self, weights_dir: Path | None) -> tuple[MetricSpec, ...]:
        """The spec of `niqe`."""
        variant = (
            f"pyiqa's 'niqe' (rounded Y of YIQ, whole {BLOCK}x{BLOCK} blocks, no crop), computed in numpy; "
            "mean over frames that have a value"
        )
        version = "bench 1, within 3e-5 of the score of pyiqa 0.1.16"
        digest = NIQE_PRIOR.sha256(weights_dir)
        return (MetricSpec("niqe", "NIQE", False, (0.0, None), variant, version, 3, digest),)

    def compute(self, given: MetricInput) -> dict[str, Score]:
        """Score the frames.

        Raises:
            Unavailable: the prior is not in the weights folder.
            BadInput: the prior cannot be read.
        """
        path = NIQE_PRIOR.find(given.weights_dir)
        if self._loaded is None or self._loaded[0] != path:
            self._loaded = (path, NiqePrior.read(path))
        prior = self._loaded[1]
        return {"niqe": mean_over_frames(given.output.frames, lambda frame: niqe(frame, prior), NO_VALUE)}
