"""The gradient trainer of each backend: one place to plug another in."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import torch

from bench.speed.case import Backend
from orca.anchors import GaussianAnchors
from orca.config import RenderConfig, TrainConfig
from orca.field.decoders import Decoders
from orca.field.hashing import HashEncoding
from orca.stages.observations import Observation
from orca.stages.train import TrainPlan, TrainResult, train

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


_TRAINERS: dict[Backend, Trainer] = {"reference": train}


def trained_backends() -> tuple[Backend, ...]:
    """The backends that can train."""
    return tuple(_TRAINERS)


def trainer(backend: Backend) -> Trainer:
    """The trainer of a backend that is among `trained_backends`."""
    return _TRAINERS[backend]
