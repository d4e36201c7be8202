"""MUSIQ, CLIP-IQA and LLaVA-IQA: scores of learned models, available where their weights are."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

from bench.metrics.metric import MetricInput, MetricSpec, Score
from bench.metrics.per_frame import mean_over_frames
from bench.metrics.weights import WeightsFile
from orca.conventions import UInt8Array
from orca.errors import BadInput, Unavailable

__all__ = ["CLIP_RN50", "LLAVA_QUESTIONS", "MUSIQ_KONIQ", "ClipIqa", "Llava", "Musiq"]

MUSIQ_KONIQ = WeightsFile(
    "musiq", "musiq_koniq_ckpt-e95806b9.pth", "https://huggingface.co/chaofengc/IQA-PyTorch-Weights"
)
CLIP_RN50_SHA256 = "afeb0e10f9e5a86da6080e35cf09123aca3b358a0c3e3b6c78a7b63bc04b6762"
CLIP_RN50 = WeightsFile(
    "clipiqa", "RN50.pt", f"https://openaipublic.azureedge.net/clip/models/{CLIP_RN50_SHA256}/RN50.pt"
)
BAKLLAVA = WeightsFile("llava", "llava-hf/bakLlava-v1-hf", "https://huggingface.co/llava-hf/bakLlava-v1-hf")
NO_VALUE = "the model gave no finite score"

# VistaDream's questions, word for word, with its spelling.
LLAVA_QUESTIONS = {
    "noise_free": "Is the image free of noise or distortion",
    "edge": "Does the image show clear objects and sharp edges",
    "structure": "Is the overall scene coherent and realistic in terms of layout and proportions in this image",
    "detail": "Does this image show detailed textures and materials",
    "quality": (
        "Is this image overall a high quality image with clear objects, sharp edges, nice color, "
        "good overall structure, and good visual quailty"
    ),
}


class _PyiqaScore:
    """A learned no-reference metric that pyiqa runs, one frame at a time."""

    def __init__(self) -> None:
        self._loaded: tuple[tuple[Path, str], Any] | None = None

    def _mean(self, given: MetricInput, path: Path, build: Callable[[Path, str], Any]) -> Score:
        key = (path, given.device)
        if self._loaded is None or self._loaded[0] != key:
            self._loaded = (key, build(path, given.device))
        network = self._loaded[1]
        return mean_over_frames(given.output.frames, lambda frame: _score(network, frame), NO_VALUE)


class Musiq(_PyiqaScore):
    """MUSIQ (Ke et al. 2021), trained on KonIQ-10k."""

    def specs(self, weights_dir: Path | None) -> tuple[MetricSpec, ...]:
        """The spec of `musiq`."""
        variant = "pyiqa 'musiq' (KonIQ-10k); batch 1; mean over frames"
        digest = MUSIQ_KONIQ.sha256(weights_dir)
        return (MetricSpec("musiq", "MUSIQ", True, (0.0, 100.0), variant, _pyiqa_version(), 2, digest),)

    def compute(self, given: MetricInput) -> dict[str, Score]:
        """Score the frames. Raises `Unavailable` without the weights, `BadInput` if they cannot be read."""
        return {"musiq": self._mean(given, MUSIQ_KONIQ.find(given.weights_dir), _build_musiq)}


class ClipIqa(_PyiqaScore):
    """CLIP-IQA (Wang et al. 2023) on CLIP RN50 without positional embedding."""

    def specs(self, weights_dir: Path | None) -> tuple[MetricSpec, ...]:
        """The spec of `clipiqa`."""
        variant = (
            "pyiqa 'clipiqa': RN50, no positional embedding, mean over pyiqa's five prompt pairs; batch 1; "
            "mean over frames"
        )
        digest = CLIP_RN50.sha256(weights_dir)
        return (MetricSpec("clipiqa", "CLIP-IQA", True, (0.0, 1.0), variant, _pyiqa_version(), 4, digest),)

    def compute(self, given: MetricInput) -> dict[str, Score]:
        """Score the frames. Raises `Unavailable` without the weights, `BadInput` for another file of that name."""
        path = CLIP_RN50.find(given.weights_dir)
        found = CLIP_RN50.sha256(given.weights_dir)
        if found != CLIP_RN50_SHA256:  # a TorchScript archive holds code: run no other than the published one
            raise BadInput(
                f"{path} has SHA-256 {found}", CLIP_RN50_SHA256, f"get the published file: {CLIP_RN50.source}"
            )
        return {"clipiqa": self._mean(given, path, _build_clipiqa)}


class Llava:
    """LLaVA-IQA as VistaDream defines it: the share of frames for which the model answers yes."""

    def specs(self, weights_dir: Path | None) -> tuple[MetricSpec, ...]:
        """The specs of the five criteria."""
        return tuple(
            MetricSpec(
                f"llava_{criterion}",
                f"LLaVA {criterion.replace('_', '-')}",
                True,
                (0.0, 1.0),
                f"{BAKLLAVA.name}, fp16, greedy, 200 new tokens; share of frames answered yes to: {question}",
                "bench 0 (not built yet)",
                3,
            )
            for criterion, question in LLAVA_QUESTIONS.items()
        )

    def compute(self, given: MetricInput) -> dict[str, Score]:
        """Raises `Unavailable`: without the model for want of it, with it because scoring is not built yet."""
        path = BAKLLAVA.find(given.weights_dir)
        raise Unavailable(
            f"scoring with LLaVA is not built yet (the model is in {path})",
            "the other metrics",
            "leave the llava columns out of --metrics",
        )


def _pyiqa_version() -> str:
    return f"pyiqa {version('pyiqa')}"


def _build_musiq(path: Path, device: str) -> Any:
    """MUSIQ with weights read as tensors only (pyiqa's own loader would unpickle anything)."""
    import pickle

    import pyiqa
    import torch

    network = pyiqa.create_metric("musiq", pretrained=False, device=torch.device(device))
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
        network.net.load_state_dict(state.get("params", state))
    except (pickle.UnpicklingError, RuntimeError, AttributeError, EOFError, OSError) as error:
        raise BadInput(
            f"the MUSIQ weights {path} cannot be read ({type(error).__name__}: {str(error)[:200]})",
            "pyiqa's state dict of MUSIQ, trained on KonIQ-10k",
            f"get it again from {MUSIQ_KONIQ.source}",
        ) from error
    return network


def _build_clipiqa(path: Path, device: str) -> Any:
    import pyiqa
    import torch

    return pyiqa.create_metric("clipiqa", backbone=str(path), device=torch.device(device))


def _score(network: Any, frame: UInt8Array) -> float:
    import torch

    with torch.inference_mode():
        return float(network(torch.from_numpy(frame.copy()).permute(2, 0, 1)[None].float() / 255.0))
