"""LPIPS against true views (Zhang et al., "The unreasonable effectiveness of deep features", CVPR 2018), by pyiqa.

pyiqa's file holds only the five linear layers of version 0.1; the trunk is torchvision's ImageNet network, which pyiqa
would fetch by itself. Here both files are looked for in the weights folder, and are read as tensors only.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from bench.metrics.fidelity import RESIZE_RULE
from bench.metrics.metric import MetricInput, MetricSpec, Score
from bench.metrics.reference import NOTHING_HIDDEN, matched_renders, mean_over_views, no_true_view
from bench.metrics.weights import WeightsFile
from bench.metrics.weights_state import read_state
from orca.conventions import Float32Array, UInt8Array
from orca.errors import BadInput

__all__ = ["LPIPS_ALEX", "LPIPS_VGG", "MIN_SIDE", "Lpips", "LpipsVgg", "LpipsWeights", "head_state", "trunk_state"]

# The smallest image whose last layer still has a pixel is 31 a side for AlexNet.
MIN_SIDE = 32
TOO_SMALL = f"the true view is smaller than {MIN_SIDE}x{MIN_SIDE} pixels"
_PYIQA = "https://huggingface.co/chaofengc/IQA-PyTorch-Weights"
_TORCHVISION = "https://download.pytorch.org/models"


@dataclass(frozen=True)
class LpipsWeights:
    """The two files of one LPIPS.

    Attributes:
        net: pyiqa's name of the trunk.
        trunk: torchvision's ImageNet weights.
        heads: the linear layers, version 0.1.
    """

    net: Literal["alex", "vgg"]
    trunk: WeightsFile
    heads: WeightsFile

    def sha256(self, weights_dir: Path | None) -> str | None:
        """Both hashes, joined by "+"; None if a file is not there."""
        found = [self.trunk.sha256(weights_dir), self.heads.sha256(weights_dir)]
        return None if None in found else "+".join(str(digest) for digest in found)


LPIPS_ALEX = LpipsWeights(
    "alex",
    WeightsFile(
        "lpips",
        "alexnet-owt-7be5be79.pth",
        _TORCHVISION,
        "7be5be791159472b1fbf3c69796f7cb30dca7ad8466c2df70058c37116cdee02",
    ),
    WeightsFile(
        "lpips",
        "LPIPS_v0.1_alex-df73285e.pth",
        _PYIQA,
        "df73285e35b22355a2df87cdb6b70b343713b667eddbda73e1977e0c860835c0",
    ),
)
LPIPS_VGG = LpipsWeights(
    "vgg",
    WeightsFile(
        "lpips_vgg",
        "vgg16-397923af.pth",
        _TORCHVISION,
        "397923af8e79cdbb6a7127f12361acd7a2f83e06b05044ddf496e83de57a5bf0",
    ),
    WeightsFile(
        "lpips_vgg",
        "LPIPS_v0.1_vgg-a78928a0.pth",
        _PYIQA,
        "a78928a0af1e5f0fcb1f3b9e8f8c3a2a5a3de244d830ad5c1feddc79b8432868",
    ),
)


class Lpips:
    """LPIPS over the image, and its map averaged over what the input could not see."""

    weights = LPIPS_ALEX
    name = "lpips"
    needs = ("true_views", "reference_views")

    def __init__(self) -> None:
        self._loaded: tuple[tuple[Path, Path, str], Any] | None = None

    def specs(self, weights_dir: Path | None) -> tuple[MetricSpec, ...]:
        """Specs of the score and of the score inside the hidden part."""
        made = f"pyiqa {version('pyiqa')}"
        digest = self.weights.sha256(weights_dir)
        what = f"pyiqa 'lpips' 0.1, {self.weights.net}, inputs in [-1, 1]; mean over true views; {RESIZE_RULE}"
        inside = f"map averaged inside the mask of pixels that no input pixel reaches; {what}"
        title = "LPIPS" if self.weights.net == "alex" else "LPIPS (VGG)"
        return (
            MetricSpec(self.name, f"{title}, true view", False, (0.0, None), what, made, 4, digest),
            MetricSpec(f"hole_{self.name}", f"{title}, hidden part", False, (0.0, None), inside, made, 4, digest),
        )

    def compute(self, given: MetricInput) -> dict[str, Score]:
        """Score the renders at the true views.

        Raises:
            Unavailable: a weights file is missing.
            BadInput: a weights file cannot be read, or the number of renders is wrong.
        """
        reason = no_true_view(given)
        if reason is not None:
            return {name: Score(None, 0, reason) for name in (self.name, f"hole_{self.name}")}
        paths = self.weights.trunk.find(given.weights_dir), self.weights.heads.find(given.weights_dir)
        key = (*paths, given.device)
        if self._loaded is None or self._loaded[0] != key:
            self._loaded = (key, _build(self.weights.net, *paths, given.device))
        return self._scores(given, self._loaded[1])

    def _scores(self, given: MetricInput, network: Any) -> dict[str, Score]:
        whole: tuple[list[float], list[str]] = ([], [])
        inside: tuple[list[float], list[str]] = ([], [])
        for render, view in zip(matched_renders(given), given.case.true_views, strict=True):
            if min(view.image.shape[:2]) < MIN_SIDE:
                value, part, reasons = math.nan, math.nan, (TOO_SMALL, TOO_SMALL)
            else:
                value, part = _distances(network, render, view.image, view.hidden, given.device)
                reasons = ("", NOTHING_HIDDEN if math.isnan(part) else "")
            for column, number, why in zip((whole, inside), (value, part), reasons, strict=True):
                column[0].append(number)
                column[1].append(why)
        return {self.name: mean_over_views(*whole), f"hole_{self.name}": mean_over_views(*inside)}


class LpipsVgg(Lpips):
    """The same on VGG-16."""

    weights = LPIPS_VGG
    name = "lpips_vgg"


def _distances(
    network: Any, render: UInt8Array, truth: UInt8Array, hidden: NDArray[np.bool_], device: str
) -> tuple[float, float]:
    """LPIPS of the whole image, and the mean of its map inside the mask (NaN for an empty one)."""
    import torch

    def batch(image: UInt8Array) -> Any:
        # pyiqa takes [0, 1] and brings it to the [-1, 1] that the network was trained on.
        return torch.from_numpy(image.copy()).permute(2, 0, 1)[None].float().to(device) / 255.0

    with torch.inference_mode():
        network.spatial = False
        whole = float(network(batch(render), batch(truth)))
        if not hidden.any():
            return whole, math.nan
        network.spatial = True
        # The map comes back without its two last axes where these are 1: an image of one pixel, which is refused.
        here: Float32Array = network(batch(render), batch(truth))[0, 0].cpu().numpy()
    return whole, float(here[hidden].mean(dtype=np.float64))


def _build(net: Literal["alex", "vgg"], trunk: Path, heads: Path, device: str) -> Any:
    import torch
    from pyiqa.archs.lpips_arch import LPIPS

    with _empty_trunks():
        network = LPIPS(net=net, pretrained=False, version="0.1")
    network.net.load_state_dict(trunk_state(network, trunk), assign=True)
    network.load_state_dict(head_state(network, heads), strict=False)
    return network.eval().requires_grad_(False).to(torch.device(device))


@contextlib.contextmanager
def _empty_trunks() -> Iterator[None]:
    """Let pyiqa build its trunk without fetching weights: it asks torchvision for them whatever it is told."""
    import torch
    from pyiqa.archs import lpips_arch

    def without_weights(build: Any) -> Any:
        def built(weights: object = None) -> Any:
            with torch.device("meta"):  # no memory, no random numbers: the real weights come after
                return build(weights=None)

        return built

    models = lpips_arch.models
    lpips_arch.models = SimpleNamespace(alexnet=without_weights(models.alexnet), vgg16=without_weights(models.vgg16))
    try:
        yield
    finally:
        lpips_arch.models = models


def trunk_state(network: Any, path: Path) -> dict[str, Any]:
    """Weights by pyiqa's names ("slice2.3.weight") from torchvision's ("features.3.weight").

    Args:
        network: whose ``net`` says which names and shapes are wanted.
        path: torchvision's file.

    Raises:
        BadInput: the file cannot be read, or lacks a tensor of the right shape.
    """
    found = read_state(path, "torchvision's ImageNet weights of the trunk")
    wanted = {key: f"features.{key.partition('.')[2]}" for key in network.net.state_dict()}
    return _picked(found, wanted, network.net.state_dict(), path)


def head_state(network: Any, path: Path) -> dict[str, Any]:
    """The linear layers ("lin0.model.1.weight") of pyiqa's file; arguments and errors as `trunk_state`."""
    found = read_state(path, "pyiqa's LPIPS 0.1 weights")
    own = network.state_dict()
    names = [key for key in own if key.startswith("lin") and not key.startswith("lins")]
    # pyiqa lists every layer a second time as lins.N: the same tensors, so loading one set fills both.
    return _picked(found, {name: name for name in names}, own, path)


def _picked(found: dict[str, Any], wanted: dict[str, str], own: dict[str, Any], path: Path) -> dict[str, Any]:
    for key, name in wanted.items():
        tensor = found.get(name)
        if getattr(tensor, "shape", None) != own[key].shape:
            raise BadInput(
                f"{path} without a tensor {name} of shape {list(own[key].shape)}",
                "the published weights of LPIPS 0.1",
                "get the file again",
            )
    return {key: found[name] for key, name in wanted.items()}
