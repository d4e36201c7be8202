"""Optimise inserted anchors alone: target colour inside, coverage inside, appearance kept around (paper Sec. 3.3)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor, nn

from orca.anchors import GaussianAnchors
from orca.camera import Camera
from orca.config import RenderConfig
from orca.conventions import Float32Array
from orca.field.decoders import Decoders
from orca.render.flat import FlatHits, render_flat
from orca.render.selector import select

__all__ = ["LocalTarget", "optimise_new"]

_COVERAGE_WEIGHT = 0.1
_BOUNDARY_WEIGHT = 1.0
_FEATURE_RATE = 3e-2
_OPACITY_RATE = 1e-2


@dataclass(frozen=True, eq=False)
class LocalTarget:
    """What the neighbourhood of a repair should look like, in one cropped view.

    Attributes:
        camera: the crop's camera.
        rays: pixels of the crop that count, row-major, [R] int64.
        rgb: wanted colour: the fill inside, the render before the repair around it, [R, 3].
        inside: which of them lie in the hole, [R] bool.
    """

    camera: Camera
    rays: np.ndarray[tuple[int], np.dtype[np.int64]]
    rgb: Float32Array
    inside: np.ndarray[tuple[int], np.dtype[np.bool_]]


def optimise_new(
    existing: GaussianAnchors,
    new: GaussianAnchors,
    decoders: Decoders,
    target: LocalTarget,
    render: RenderConfig,
    steps: int,
    min_opacity: float,
) -> GaussianAnchors:
    """The new anchors after at most ``steps`` Adam steps on their features and opacities.

    ``existing`` and ``decoders`` are not changed: they take part in the rendering as constants. Returns the best
    state seen, so that a repair never ends worse than it was inserted.
    """
    if steps == 0 or len(new) == 0:
        return new
    ray, anchor = select(GaussianAnchors.concatenate(existing, new), target.camera, render).flat(target.rays)
    # Only anchors that these rays hit take part: the rest of the scene costs nothing.
    used, own = (torch.from_numpy(x) for x in np.unique(anchor, return_inverse=True))
    hits = FlatHits(torch.from_numpy(ray), own, len(target.rays))
    old_used, new_used = used[used < len(existing)], used[used >= len(existing)] - len(existing)
    constant, movable = existing.subset(old_used), new.subset(new_used)
    features = nn.Parameter(movable.features.clone())
    opacity = nn.Parameter(movable.opacity_logits.clone())
    moving = (_Adam(features, _FEATURE_RATE), _Adam(opacity, _OPACITY_RATE))
    floor = float(np.log(min_opacity / (1 - min_opacity))) if min_opacity < 1 else 10.0
    best, best_loss = (movable.features, movable.opacity_logits), float("inf")
    neighbourhood = GaussianAnchors.concatenate(constant, movable)
    for step in range(steps + 1):
        moved = replace(
            neighbourhood,
            features=torch.cat([constant.features, features]),
            opacity_logits=torch.cat([constant.opacity_logits, opacity]),
        )
        loss = _loss(moved, hits, decoders, target, render)
        if loss.item() < best_loss:
            best, best_loss = (features.detach().clone(), opacity.detach().clone()), loss.item()
        if step == steps:
            break
        for adam, gradient in zip(moving, torch.autograd.grad(loss, [features, opacity]), strict=True):
            adam.step(gradient)
        with torch.no_grad():
            opacity.clamp_(min=floor + 1e-4)
    out_features, out_opacity = new.features.clone(), new.opacity_logits.clone()
    out_features[new_used], out_opacity[new_used] = best
    return replace(new, features=out_features, opacity_logits=out_opacity)


class _Adam:
    """Adam (Kingma and Ba 2015) on one tensor. `torch.optim` would load torch's compiler first: three seconds."""

    def __init__(self, parameter: Tensor, rate: float) -> None:
        self.parameter, self.rate, self.steps = parameter, rate, 0
        self.first, self.second = torch.zeros_like(parameter), torch.zeros_like(parameter)

    @torch.no_grad()
    def step(self, gradient: Tensor) -> None:
        """Move the parameter in place."""
        self.steps += 1
        self.first.lerp_(gradient, 1 - 0.9)
        self.second.lerp_(gradient.square(), 1 - 0.999)
        first, second = self.first / (1 - 0.9**self.steps), self.second / (1 - 0.999**self.steps)
        self.parameter.sub_(self.rate * first / (second.sqrt() + 1e-8))


def _loss(
    anchors: GaussianAnchors, hits: FlatHits, decoders: Decoders, target: LocalTarget, render: RenderConfig
) -> Tensor:
    """Colour and coverage inside the hole, appearance around it."""
    width = target.camera.width
    pixels = torch.from_numpy(np.stack([target.rays % width + 0.5, target.rays // width + 0.5], 1)).float()
    rgb, alpha, _ = render_flat(anchors, decoders, target.camera, pixels, hits, render)
    image = rgb + (1 - alpha)[:, None] * render.background
    error = (image - torch.from_numpy(target.rgb)).abs().mean(1)
    inside = torch.from_numpy(target.inside)
    colour = error[inside].mean()
    coverage = (1 - alpha[inside]).mean()
    boundary = error[~inside].mean() if bool((~inside).any()) else torch.zeros(())
    return colour + _COVERAGE_WEIGHT * coverage + _BOUNDARY_WEIGHT * boundary
