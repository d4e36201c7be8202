"""NIQE (Mittal, Soundararajan and Bovik 2013): a no-reference score from a small prior file, through pyiqa."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

from bench.metrics.metric import MetricInput, MetricSpec, Score
from bench.metrics.per_frame import mean_over_frames
from bench.metrics.weights import WeightsFile
from orca.conventions import UInt8Array
from orca.errors import BadInput

__all__ = ["NIQE_PRIOR", "Niqe"]

NIQE_PRIOR = WeightsFile(
    "niqe",
    "niqe_modelparameters.mat",
    "https://huggingface.co/chaofengc/IQA-PyTorch-Weights (or BasicSR's niqe priors)",
)
BLOCK = 96
NO_VALUE = f"flat, or fewer than two whole blocks of {BLOCK}x{BLOCK} pixels"


class Niqe:
    """Distance of a frame's natural-scene statistics from those of pristine photographs; lower is better."""

    def __init__(self) -> None:
        self._loaded: tuple[Path, Callable[[UInt8Array], float | None]] | None = None

    def specs(self, weights_dir: Path | None) -> tuple[MetricSpec, ...]:
        """The spec of `niqe`; imports no network library."""
        variant = (
            f"pyiqa 'niqe': rounded Y of YIQ, float64, whole {BLOCK}x{BLOCK} blocks, no crop; one frame at a time; "
            "mean over frames that have a value"
        )
        return (
            MetricSpec(
                "niqe", "NIQE", False, (0.0, None), variant, _pyiqa_version(), 3, NIQE_PRIOR.sha256(weights_dir)
            ),
        )

    def compute(self, given: MetricInput) -> dict[str, Score]:
        """Score the frames.

        Raises:
            Unavailable: the prior is not in the weights folder.
            BadInput: the prior cannot be read.
        """
        path = NIQE_PRIOR.find(given.weights_dir)
        if self._loaded is None or self._loaded[0] != path:
            self._loaded = (path, _load(path))
        return {"niqe": mean_over_frames(given.output.frames, self._loaded[1], NO_VALUE)}


def _pyiqa_version() -> str:
    return f"pyiqa {version('pyiqa')}"


def _load(path: Path) -> Callable[[UInt8Array], float | None]:
    """Build the scorer on the CPU: float64, and the same number on every machine."""
    import pyiqa
    import torch

    try:
        metric = pyiqa.create_metric("niqe", pretrained_model_path=str(path), device=torch.device("cpu"))
    except (KeyError, ValueError, OSError, NotImplementedError) as error:
        raise BadInput(
            f"the NIQE prior {path} cannot be read ({error})",
            "a MATLAB file with mu_prisparam and cov_prisparam",
            f"get it again from {NIQE_PRIOR.source}",
        ) from error

    def score(frame: UInt8Array) -> float | None:
        return _score(metric, frame)

    return score


def _score(metric: Any, frame: UInt8Array) -> float | None:
    import torch
    from torch.linalg import LinAlgError  # type: ignore[attr-defined]

    if (frame.shape[0] // BLOCK) * (frame.shape[1] // BLOCK) < 2:
        return None  # pyiqa fails on no block, and one block has no covariance
    batch = torch.from_numpy(frame.copy()).permute(2, 0, 1)[None].float() / 255.0
    try:
        return float(metric(batch))
    except LinAlgError:
        return None  # a flat frame: its statistics are not finite, and the pseudo-inverse does not converge
