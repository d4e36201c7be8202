"""The gradient trainer of each backend: one place to plug another in."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from bench.speed.case import Backend
from orca.anchors import GaussianAnchors
from orca.config import RenderConfig, TrainConfig
from orca.field.decoders import Decoders
from orca.field.hashing import HashEncoding
from orca.render.reference import render_rays
from orca.stages.observations import Observation
from orca.stages.train import Trainable, TrainPlan, TrainResult, ViewRays, train

__all__ = ["Trainer", "trained_backends", "trainer"]


class Trainer(Protocol):
    """What `orca.stages.train.train` looks like; ``progress`` is called after every step."""

    def __call__(
        self,
        anchors: GaussianAnchors,
        decoders: Decoders,
        encoding: HashEncoding,
        observed: Sequence[Observation],
        plan: TrainPlan,
        config: TrainConfig,
        render: RenderConfig,
        generator: torch.Generator,
        progress: Callable[[int, int], None],
    ) -> TrainResult: ...


def _render_padded(
    model: Trainable, decoders: Decoders, views: Sequence[ViewRays], config: RenderConfig
) -> list[tuple[Tensor, Tensor]]:
    """A batch through the reference renderer: every anchor is prepared, every ray padded to the longest."""
    images = []
    for camera, hits, rays in views:
        anchors = replace(model.parameters_as_anchors(), features=model.start.features + model.encoding.formula())
        pixels = torch.from_numpy(np.stack([rays % camera.width + 0.5, rays // camera.width + 0.5], 1)).float()
        rgb, alpha, _ = render_rays(anchors, decoders, camera, pixels, torch.from_numpy(hits.padded(rays)), config)
        images.append((rgb, alpha))
    return images


_TRAINERS: dict[Backend, Trainer] = {"fast": train, "reference": partial(train, render_batch=_render_padded)}


def trained_backends() -> tuple[Backend, ...]:
    """The backends that can train."""
    return tuple(_TRAINERS)


def trainer(backend: Backend) -> Trainer:
    """The trainer of a backend that is among `trained_backends`."""
    return _TRAINERS[backend]
