"""The metric `musiq`: MUSIQ trained on KonIQ-10k, through pyiqa's network and weights."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.metrics.metric import MetricInput, MetricSpec, Score
from bench.metrics.per_frame import Each, FrameScore, check_frames, mean_over_frames
from bench.metrics.weights import WeightsFile
from bench.metrics.weights_state import read_state
from orca.conventions import UInt8Array
from orca.errors import BadInput

if TYPE_CHECKING:
    from torch import Tensor

__all__ = ["MUSIQ_KONIQ", "Musiq", "as_image", "load_musiq", "read_musiq_state"]

MUSIQ_KONIQ = WeightsFile(
    "musiq",
    "musiq_koniq_ckpt-e95806b9.pth",
    "https://huggingface.co/chaofengc/IQA-PyTorch-Weights/resolve/main/musiq_koniq_ckpt-e95806b9.pth",
    "e95806b9eae5f3814c410f574ba8e552362bd5bc63d758ed5b97860f5d6185aa",
)
_WHAT = "pyiqa's state dict of MUSIQ, trained on KonIQ-10k"
SHORT_SCALE = 224  # the smaller of the two sizes to which MUSIQ brings the longer side
NO_VALUE = f"a frame at least {2 * SHORT_SCALE} times as long as it is wide, or the model gave no finite score"


class Musiq:
    """MUSIQ (Ke et al. 2021), trained on KonIQ-10k."""

    needs = ("frames", "shape")

    def __init__(self) -> None:
        self._loaded: tuple[tuple[Path, str], FrameScore] | None = None

    def specs(self, weights_dir: Path | None) -> tuple[MetricSpec, ...]:
        """The spec of `musiq`."""
        variant = "pyiqa 'musiq' (KonIQ-10k); batch 1; mean over frames"
        made_by = f"bench 1, within 1e-6 of the score of pyiqa {version('pyiqa')} (float32 sums in another order)"
        return (MetricSpec("musiq", "MUSIQ", True, (0.0, 100.0), variant, made_by, 2, MUSIQ_KONIQ.sha256(weights_dir)),)

    def compute(self, given: MetricInput) -> dict[str, Score]:
        """Score the frames.

        Raises:
            Unavailable: the weights are not there.
            BadInput: the weights cannot be read, or the frames are not [n, H, W, 3] uint8.
        """
        frames = given.output.frames
        check_frames(frames)
        path = MUSIQ_KONIQ.find(given.weights_dir)
        key = (path, given.device)
        if self._loaded is None or self._loaded[0] != key:
            self._loaded = (key, _on_device(load_musiq(path), given.device))
        return {"musiq": mean_over_frames(frames, self._loaded[1], NO_VALUE, _on_cores(given.device))}


def load_musiq(path: Path) -> Any:
    """pyiqa's `MUSIQ` metric with weights read as tensors only (pyiqa's own loader would unpickle anything).

    Raises:
        BadInput: the file holds no state dict of MUSIQ for KonIQ-10k.
    """
    import pyiqa
    import torch

    metric = pyiqa.create_metric("musiq", pretrained=False, device=torch.device("cpu"))
    try:
        metric.net.load_state_dict(read_musiq_state(path))
    except RuntimeError as error:  # names or shapes of another network
        raise BadInput(
            f"the MUSIQ weights {path} do not fit ({str(error)[:200]})",
            _WHAT,
            f"get it again from {MUSIQ_KONIQ.source}",
        ) from error
    return metric


def read_musiq_state(path: Path) -> dict[str, Any]:
    """The tensors of MUSIQ's file, by name. Raises `BadInput` for any other kind of file."""
    return read_state(path, _WHAT, MUSIQ_KONIQ.source)


def _on_device(metric: Any, device: str) -> FrameScore:
    """On a CPU our forward pass of pyiqa's network; elsewhere pyiqa's own."""
    if device != "cpu":
        import torch

        metric = metric.to(torch.device(device))
        return lambda frame: None if _too_long(frame) else float(metric(as_image(frame).to(device)))
    from bench.metrics.musiq_network import CpuMusiq

    network = CpuMusiq(metric.net)
    return lambda frame: None if _too_long(frame) else network(as_image(frame))


def as_image(frame: UInt8Array) -> Tensor:
    """A frame [H, W, 3] uint8 as pyiqa takes it: [1, 3, H, W] float32 in [0, 1]."""
    import torch

    return torch.from_numpy(frame.copy()).permute(2, 0, 1)[None].float() / 255


def _too_long(frame: UInt8Array) -> bool:
    """Whether the shorter side vanishes at the smaller scale."""
    shorter, longer = sorted(int(side) for side in frame.shape[:2])
    return round(shorter * (SHORT_SCALE / longer)) < 1


def _on_cores(device: str) -> Each:
    if device != "cpu":
        return map
    from orca.threads import map_on_cores

    return map_on_cores
