"""Closed-form against random initialisation: PSNR of the input view over the CPU time of the planar fit."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np
import torch

from bench.datasets.case import SceneCase
from bench.speed.trainers import trained_backends, trainer
from orca.anchors import GaussianAnchors
from orca.config import ReconstructConfig, TrainConfig, get_preset
from orca.conventions import to_float
from orca.field.decoders import Decoders, analytic_decoders
from orca.field.hashing import HashEncoding
from orca.render import Renderer
from orca.stages.canvas import Canvas
from orca.stages.observations import observations
from orca.stages.planar import place, planar_anchors, rest_positions
from orca.stages.solve import solve_colours
from orca.stages.train import TrainPlan

__all__ = ["INITIALISATIONS", "Curve", "Point", "fit_curve"]

Initialisation = Literal["closed_form", "random"]
INITIALISATIONS: tuple[Initialisation, ...] = ("closed_form", "random")
_EVALUATIONS = 10


@dataclass(frozen=True)
class Point:
    """How far a fit had come.

    Attributes:
        cpu_s, wall_s: seconds since the image was at hand, without those spent on measuring PSNR.
        solver_steps: Gauss-Newton steps of the closed form.
        iterations: gradient steps after it.
        psnr: of the input view, dB.
    """

    cpu_s: float
    wall_s: float
    solver_steps: int
    iterations: int
    psnr: float


@dataclass(frozen=True)
class Curve:
    """One scene fitted from one initialisation."""

    scene: str
    initialisation: Initialisation
    anchors: int
    points: tuple[Point, ...]

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self)


class _Clock:
    """CPU and wall seconds since it was made."""

    def __init__(self) -> None:
        self._start = self._now()

    @staticmethod
    def _now() -> tuple[float, float]:
        return time.process_time(), time.perf_counter()

    def read(self) -> tuple[float, float]:
        now = self._now()
        return now[0] - self._start[0], now[1] - self._start[1]


@dataclass
class _Fit:
    """A planar fit under way: what the two initialisations share is the same object code, placement and encoding."""

    case: SceneCase
    config: ReconstructConfig

    def __post_init__(self) -> None:
        image = to_float(self.case.image)
        self.canvas = Canvas(image, self.case.depth, self.case.camera, (0, 0, 0, 0))
        self.observed = observations(self.canvas, 1.0)

    def start(self) -> tuple[GaussianAnchors, HashEncoding, torch.Generator]:
        """Placed anchors, features zero but for the density channel, and a fresh encoding."""
        generator = torch.Generator().manual_seed(0)
        grid = place(self.canvas, self.config.planar)
        encoding = HashEncoding(rest_positions(self.canvas, grid), self.config.hash, generator)
        return planar_anchors(self.canvas, grid, self.config.planar), encoding, generator

    def solved(
        self, anchors: GaussianAnchors, generator: torch.Generator, steps: int
    ) -> tuple[GaussianAnchors, Decoders]:
        """The closed form after so many Gauss-Newton steps."""
        planar = replace(self.config.planar, gauss_newton_steps=steps)
        decoders = analytic_decoders(planar.density, generator)
        return solve_colours(anchors, decoders, self.observed, planar, self.config.render), decoders

    def psnr(self, anchors: GaussianAnchors, decoders: Decoders) -> float:
        rgb = Renderer(anchors, decoders, self.config.render).render(self.case.camera).rgb
        error = np.clip(rgb, 0, 1) - self.canvas.image
        return float(-10 * np.log10(max(float(np.square(error).mean()), 1e-12)))


@dataclass(frozen=True, eq=False)
class _Start:
    """Where the gradient takes over: anchors without the encoding's share, and what it took to get there."""

    anchors: GaussianAnchors
    decoders: Decoders
    encoding: HashEncoding
    generator: torch.Generator
    reached: Point


def fit_curve(case: SceneCase, initialisation: Initialisation, iterations: int) -> Curve:
    """Fit stage 1 of the draft preset without a margin; everything but the initialisation is the same.

    The closed form gives a point after each Gauss-Newton step and goes on by gradient; the random start has the
    gradient alone. Compile and warm up before: a first call pays for numba.

    Args:
        case: the scene.
        initialisation: of features and decoders.
        iterations: gradient steps, the first ones of the paper's schedule.
    """
    config = get_preset("draft")
    fit = _Fit(case, replace(config, train=_beginning(config.train, iterations)))
    if initialisation == "closed_form":
        starts = [_closed_form(fit, steps) for steps in range(1, config.planar.gauss_newton_steps + 1)]
    else:
        starts = [_random(fit)]
    last, points = starts[-1], [start.reached for start in starts]
    points += _trained(fit, last, iterations)
    return Curve(case.name, initialisation, len(last.anchors), tuple(points))


def _closed_form(fit: _Fit, steps: int) -> _Start:
    """The whole fit with so many Gauss-Newton steps, timed from the image on."""
    clock = _Clock()
    anchors, encoding, generator = fit.start()
    anchors, decoders = fit.solved(anchors, generator, steps)
    cpu, wall = clock.read()
    return _Start(anchors, decoders, encoding, generator, Point(cpu, wall, steps, 0, fit.psnr(anchors, decoders)))


def _random(fit: _Fit) -> _Start:
    """Random decoders, and features from a random encoding alone."""
    clock = _Clock()
    anchors, encoding, generator = fit.start()
    decoders = Decoders(generator=generator)
    anchors = anchors.with_features(torch.zeros_like(anchors.features))
    cpu, wall = clock.read()
    psnr = fit.psnr(anchors.with_features(encoding().detach()), decoders)
    return _Start(anchors, decoders, encoding, generator, Point(cpu, wall, 0, 0, psnr))


def _beginning(train: TrainConfig, iterations: int) -> TrainConfig:
    """The schedule of the paper's whole run, cut off: a rate that fell within so few steps would be no fair one."""
    share = iterations / get_preset("paper").planar.max_iterations
    final = train.lr_field * (train.lr_field_final / train.lr_field) ** min(1.0, share)
    return replace(train, lr_field_final=final, eval_every=max(1, iterations // _EVALUATIONS), patience=10**9)


def _trained(fit: _Fit, start: _Start, iterations: int) -> list[Point]:
    """Gradient steps from a start: a point at each evaluation."""
    if iterations == 0:
        return []
    train = trainer("fast" if "fast" in trained_backends() else "reference")
    clock, marks = _Clock(), list[tuple[float, float]]()
    anchors = start.anchors.with_features(start.anchors.features + start.encoding().detach())
    history = train(
        anchors,
        start.decoders,
        start.encoding,
        fit.observed,
        TrainPlan(iterations, iterations, train_means=False, train_extents=False),
        fit.config.train,
        fit.config.render,
        start.generator,
        lambda done, total: marks.append(clock.read()),
    ).history
    spent, before = _without_evaluations(np.array(marks), fit.config.train.eval_every), start.reached
    return [
        replace(
            before,
            cpu_s=before.cpu_s + float(spent[step - 1, 0]),
            wall_s=before.wall_s + float(spent[step - 1, 1]),
            iterations=step,
            psnr=psnr,
        )
        for step, psnr, _ in history
    ]


def _without_evaluations(marks: np.ndarray[Any, np.dtype[np.float64]], every: int) -> np.ndarray[Any, Any]:
    """Time after each step, [steps, 2], as if none had been followed by an evaluation.

    The step after an evaluation is counted as the median of the steps that follow none.
    """
    durations = np.diff(marks, axis=0, prepend=0.0)
    after = np.arange(len(durations)) % every == 0
    after[0] = False  # the first step found the hits, and that counts
    plain = durations[~after][1:]
    if len(plain):
        durations[after] = np.median(plain, axis=0)
    return np.asarray(durations.cumsum(0))
