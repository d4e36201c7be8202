"""Seeded random weights in the form of the real ones: nothing of the real ones is needed to compare two programs."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from bench.adapters.adapter import MethodOutput
from bench.metrics.metric import MetricInput
from tests.bench.small_cases import make_case, noise_image, plane

CASE = make_case(noise_image(4, 5), plane(4, 5), [np.eye(4)])


def given(frames: NDArray[Any], weights_dir: Any) -> MetricInput:
    return MetricInput(CASE, MethodOutput(frames), weights_dir)


def as_tensor(frame: NDArray[np.uint8]) -> torch.Tensor:
    return torch.from_numpy(frame.copy()).permute(2, 0, 1)[None].float() / 255


def odd_frames(height: int, width: int) -> NDArray[np.uint8]:
    """Noise twice, grey noise, black, white, one colour."""
    noise = noise_image(height, width, 1)
    grey = np.repeat(noise[..., :1], 3, axis=2)
    flat = np.broadcast_to(np.array([200, 30, 90], np.uint8), noise.shape)
    return np.stack([noise, noise, grey, np.zeros_like(noise), np.full_like(noise, 255), flat])


def musiq_metric(seed: int = 0) -> Any:
    """pyiqa's MUSIQ with random weights whose scores are as large, and as far apart, as real ones (about 40 to 70)."""
    import pyiqa

    torch.manual_seed(seed)
    metric = pyiqa.create_metric("musiq", pretrained=False, device=torch.device("cpu"))
    state = metric.net.state_dict()
    for name, value in state.items():
        if value.ndim == 1 and ("norm" in name or ".gn" in name or name.startswith("gn")):  # else all ones and zeros
            value += 0.2 * torch.randn(value.shape)
    frames = [as_tensor(noise_image(32, 32)), torch.zeros(1, 3, 32, 32)]
    with torch.inference_mode():
        raw = torch.tensor([float(metric(frame)) for frame in frames])
    gain = 10 / float(raw.std())
    state["head.weight"] *= gain
    state["head.bias"].copy_(gain * state["head.bias"] + 55 - gain * raw.mean())
    return metric


def clip_state(
    seed: int = 0, width: int = 8, layers: tuple[int, int, int, int] = (1, 2, 1, 1)
) -> dict[str, torch.Tensor]:
    """The state dict of a CLIP ResNet in OpenAI's form, random, every number one that half precision can hold."""
    from pyiqa.archs.clip_model import CLIP

    torch.manual_seed(seed)
    model = CLIP(64, 224, layers, width, None, 77, 49408, 64, 1, 2)
    state = model.state_dict()
    for name, value in state.items():
        if "running_var" in name:
            value.copy_(1 + 0.3 * torch.rand(value.shape))
        elif "bn" in name and name.endswith("weight"):  # the last of each block begins at 0: the image would not matter
            value.copy_(1 + 0.2 * torch.randn(value.shape))
        elif name.endswith("bias"):
            value.copy_(0.05 * torch.randn(value.shape))
        elif value.ndim == 4:  # as large as what comes in, layer after layer
            value.copy_(torch.randn(value.shape) * (2 / value[0].numel()) ** 0.5)
        elif name == "logit_scale":
            value.fill_(np.log(100.0))  # as OpenAI's
    return {name: value.half().float() if value.is_floating_point() else value for name, value in state.items()}
