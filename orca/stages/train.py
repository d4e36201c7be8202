"""Gradient training of stages 1 and 2: batches of rays through the flat renderer, Adam, early stopping."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional as F

from orca.anchors import GaussianAnchors
from orca.camera import Camera
from orca.config import RenderConfig, TrainConfig
from orca.field.decoders import Decoders
from orca.field.hashing import HashEncoding
from orca.render.flat import FlatHits, render_flat
from orca.render.hits import HitList
from orca.render.renderer import Renderer
from orca.stages.early_stopping import EarlyStopping
from orca.stages.observations import Observation

__all__ = ["RenderBatch", "TrainPlan", "TrainResult", "Trainable", "ViewRays", "train"]


@dataclass(frozen=True)
class TrainPlan:
    """What a stage trains and for how long.

    Attributes:
        max_iterations: steps at most.
        arm_after: early stopping may act after this many steps.
        train_means: whether means may move (stage 2: never).
        train_extents: whether log-variances and quaternions may change.
    """

    max_iterations: int
    arm_after: int
    train_means: bool
    train_extents: bool


@dataclass(frozen=True)
class TrainResult:
    """Trained anchors (features baked) and how training went.

    Attributes:
        anchors: the anchors, without a graph.
        iterations: steps taken.
        stopped: "max_iterations" or "early_stopping".
        history: (step, PSNR, smoothed PSNR) at every evaluation.
    """

    anchors: GaussianAnchors
    iterations: int
    stopped: str
    history: tuple[tuple[int, float, float], ...]


class Trainable(nn.Module):
    """The anchors as parameters; features are what they carry plus the hash encoding at their rest positions."""

    def __init__(self, anchors: GaussianAnchors, encoding: HashEncoding) -> None:
        super().__init__()
        # What the anchors carry besides the encoding; the sum is what they come with and what they leave with.
        self.start = anchors.with_features(anchors.features - encoding().detach())
        self.encoding = encoding
        self.means = nn.Parameter(anchors.means.clone())
        self.log_variances = nn.Parameter(anchors.log_variances.clone())
        self.quaternions = nn.Parameter(anchors.quaternions.clone())
        self.opacity_logits = nn.Parameter(anchors.opacity_logits.clone())

    def some(self, index: Tensor) -> GaussianAnchors:
        """Some of the anchors, with a graph: a batch looks at few of them."""
        return GaussianAnchors(
            means=self.means.index_select(0, index),
            log_variances=self.log_variances.index_select(0, index),
            quaternions=self.quaternions.index_select(0, index),
            opacity_logits=self.opacity_logits.index_select(0, index),
            features=self.start.features.index_select(0, index) + self.encoding(index),
            stage=self.start.stage.index_select(0, index),
        )

    def anchors(self) -> GaussianAnchors:
        return replace(self.parameters_as_anchors(), features=self.start.features + self.encoding())

    def parameters_as_anchors(self) -> GaussianAnchors:
        """All anchors with the features that the encoding adds to."""
        return replace(
            self.start,
            means=self.means,
            log_variances=self.log_variances,
            quaternions=self.quaternions,
            opacity_logits=self.opacity_logits,
        )

    def optimiser(self, decoders: Decoders, plan: TrainPlan, config: TrainConfig) -> torch.optim.Adam:
        field = [*self.encoding.parameters(), *decoders.parameters()]
        groups = [
            {"params": field, "lr": config.lr_field},
            {"params": [self.opacity_logits], "lr": config.lr_opacity},
        ]
        if plan.train_means:
            groups.append({"params": [self.means], "lr": config.lr_means})
        if plan.train_extents:
            groups.append({"params": [self.log_variances], "lr": config.lr_log_variances})
            groups.append({"params": [self.quaternions], "lr": config.lr_quaternions})
        return torch.optim.Adam(groups, eps=config.adam_eps, fused=True)


ViewRays = tuple[Camera, HitList, NDArray[np.int64]]  # a view, its hits, and which of its rays
RenderBatch = Callable[[Trainable, Decoders, Sequence[ViewRays], RenderConfig], Sequence[tuple[Tensor, Tensor]]]


def train(
    anchors: GaussianAnchors,
    decoders: Decoders,
    encoding: HashEncoding,
    observed: Sequence[Observation],
    plan: TrainPlan,
    config: TrainConfig,
    render: RenderConfig,
    generator: torch.Generator,
    progress: Callable[[int, int], None] = lambda done, total: None,
    render_batch: RenderBatch | None = None,
) -> TrainResult:
    """Fit anchors, encoding and decoders (in place) to the observations; loss: smooth-L1, beta 1, on RGB.

    The anchors' features include the encoding's contribution, before and after. The device is that of the anchors.
    Hit lists are integers: they are found once, and again at every evaluation if the geometry moves. The input view
    (first observation) is what early stopping watches. On the CPU the same generator gives the same result.
    ``render_batch`` takes the place of `orca.render.flat`, for comparison.
    """
    model = Trainable(anchors, encoding)
    optimiser = model.optimiser(decoders, plan, config)
    decay = (config.lr_field_final / config.lr_field) ** (1 / max(1, plan.max_iterations))
    stopping = EarlyStopping(config.min_gain_db, config.patience, config.smoothing, plan.arm_after)
    hits = _hit_lists(model, decoders, observed, render)
    stopped, step = "max_iterations", 0
    while step < plan.max_iterations:
        with _repeatable(model.means.device):
            loss = _batch_loss(model, decoders, observed, hits, config, render, generator, render_batch or _render_flat)
            optimiser.zero_grad(set_to_none=True)
            loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        optimiser.param_groups[0]["lr"] *= decay
        step += 1
        progress(step, plan.max_iterations)
        if step % config.eval_every == 0:
            if plan.train_means or plan.train_extents:
                hits = _hit_lists(model, decoders, observed, render)
            if stopping.update(step, _psnr(model, decoders, observed[0], render)):
                stopped = "early_stopping"
                break
    return TrainResult(model.anchors().detached(), step, stopped, tuple(stopping.history))


@contextmanager
def _repeatable(device: torch.device) -> Iterator[None]:
    """Gradients that do not depend on the order in which threads add them, on the CPU; elsewhere they may."""
    memory: Any = torch.utils.deterministic  # its attribute is made at run time
    before, filled = torch.are_deterministic_algorithms_enabled(), memory.fill_uninitialized_memory
    torch.use_deterministic_algorithms(before or device.type == "cpu")
    memory.fill_uninitialized_memory = filled and before  # nothing here reads such memory
    try:
        yield
    finally:
        torch.use_deterministic_algorithms(before)
        memory.fill_uninitialized_memory = filled


def _hit_lists(
    model: Trainable, decoders: Decoders, observed: Sequence[Observation], render: RenderConfig
) -> list[HitList]:
    renderer = Renderer(model.anchors(), decoders, render, str(model.means.device))
    return [renderer.hits(o.camera) for o in observed]


def _batch_loss(
    model: Trainable,
    decoders: Decoders,
    observed: Sequence[Observation],
    hits: Sequence[HitList],
    config: TrainConfig,
    render: RenderConfig,
    generator: torch.Generator,
    render_batch: RenderBatch,
) -> Tensor:
    """Loss of one random batch, drawn from the observations in proportion to their size."""
    sizes = np.array([len(o.rays) for o in observed])
    counts = [max(1, round(config.batch_rays * float(share))) for share in sizes / sizes.sum()]
    chosen = [
        torch.randint(len(o.rays), (n,), generator=generator).numpy() for o, n in zip(observed, counts, strict=True)
    ]
    views = [(o.camera, h, o.rays[c]) for o, h, c in zip(observed, hits, chosen, strict=True)]
    device = model.means.device
    total = torch.zeros((), device=device)
    for o, c, (rgb, alpha) in zip(observed, chosen, render_batch(model, decoders, views, render), strict=True):
        behind = torch.rand(len(c), 3, generator=generator).to(device) if config.random_background else 0.0
        target = torch.from_numpy(o.colour[c]).to(device)
        image = rgb + (1 - alpha)[:, None] * behind
        total = total + F.smooth_l1_loss(image, target, beta=1.0, reduction="sum") / (3 * config.batch_rays)
    return total


def _render_flat(
    model: Trainable, decoders: Decoders, views: Sequence[ViewRays], config: RenderConfig
) -> list[tuple[Tensor, Tensor]]:
    """Colour [R, 3] and alpha [R] of some rays of each view; only the anchors they hit are looked at."""
    device = model.means.device
    found = [hits.flat(rays) for _, hits, rays in views]
    used, anchor = np.unique(np.concatenate([a for _, a in found]), return_inverse=True)
    some = model.some(torch.from_numpy(used).to(device))
    images, low = [], 0
    for (camera, _, rays), (ray, mine) in zip(views, found, strict=True):
        pixels = torch.from_numpy(np.stack([rays % camera.width + 0.5, rays // camera.width + 0.5], 1)).float()
        own = torch.from_numpy(anchor[low : low + len(mine)])
        flat = FlatHits(torch.from_numpy(ray).to(device), own.to(device), len(rays))
        rgb, alpha, _ = render_flat(some, decoders, camera, pixels.to(device), flat, config)
        images.append((rgb, alpha))
        low += len(mine)
    return images


def _psnr(model: Trainable, decoders: Decoders, observation: Observation, render: RenderConfig) -> float:
    rendered = Renderer(model.anchors(), decoders, render, str(model.means.device)).render(observation.camera)
    error = rendered.rgb.reshape(-1, 3)[observation.rays] - observation.colour
    return float(-10 * np.log10(max(float(np.square(error).mean()), 1e-12)))
