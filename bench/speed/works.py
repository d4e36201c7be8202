"""The four cases as things to run: each prepares once and times one execution when called."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

import numpy as np
import torch

from bench.speed.case import Backend, Setting
from bench.speed.timing import Sample, stopwatch
from bench.speed.trainers import trainer
from bench.speed.workshop import Workshop, config_for
from orca.anchors import GaussianAnchors
from orca.conventions import Float32Array
from orca.field.decoders import Decoders
from orca.field.hashing import HashEncoding
from orca.priors.choose import Priors
from orca.priors.hub import ModelAccess
from orca.render import Renderer
from orca.repair.insert import InsertConfig
from orca.repair.loop import RepairResult, repair
from orca.stages.canvas import make_canvas
from orca.stages.observations import observations
from orca.stages.planar import place, planar_anchors, rest_positions
from orca.stages.train import TrainPlan

__all__ = ["Work", "build_work", "renderer_of"]

_STRIDE = 10  # frames of the path between one round's camera and the next
_STEPS = 3  # timed gradient steps a round, after one that also finds the hits
_MARGIN_RESOLUTION = 4.0
_REPAIR_VIEWS = 8


class Work(Protocol):
    """One backend of one setting, ready to be timed."""

    def __call__(self, number: int) -> Sample:
        """Do it once, as round ``number``."""
        ...

    def facts(self) -> dict[str, float | int | None]:
        """What was measured besides time: anchors, hits_per_ray, psnr, repairs."""
        ...


def build_work(setting: Setting, backend: Backend, workshop: Workshop) -> Work:
    """Prepare a case for one backend."""
    kinds: dict[str, Callable[[Setting, Backend, Workshop], Work]] = {
        "frame": FrameWork,
        "fit": FitWork,
        "step": StepWork,
        "stage3": RepairWork,
    }
    return kinds[setting.case](setting, backend, workshop)


def renderer_of(anchors: GaussianAnchors, decoders: Decoders, setting: Setting, backend: Backend) -> Renderer:
    """A renderer of either backend."""
    render = config_for(setting.anchors, setting.mode, setting.width).render
    return Renderer(anchors, decoders, render, backend="compiled" if backend == "fast" else "reference")


class FrameWork:
    """One frame; every round has another camera of the path, so no hit is known beforehand."""

    def __init__(self, setting: Setting, backend: Backend, workshop: Workshop) -> None:
        scene = workshop.scene(setting.anchors, setting.mode)
        self.renderer = renderer_of(scene.anchors, scene.decoders, setting, backend)
        inputs = workshop.inputs(workshop.base_width)
        self.views = [view.resized(setting.width, setting.width) for view in inputs.views]
        self.scene, self.inputs, self.at_base = scene, inputs, setting.width == workshop.base_width
        self.rgb: Float32Array | None = None

    def __call__(self, number: int) -> Sample:
        camera = self.views[(number + 1) * _STRIDE % len(self.views)]

        def render() -> None:
            self.rgb = self.renderer.render(camera).rgb

        return stopwatch(render)

    def facts(self) -> dict[str, float | int | None]:
        hits = self.renderer.hits(self.views[_STRIDE])
        psnr = None
        if self.at_base:
            error = np.clip(self.renderer.render(self.inputs.camera).rgb, 0, 1) - self.inputs.image
            psnr = float(-10 * np.log10(max(float(np.square(error).mean()), 1e-12)))
        return {"anchors": self.scene.num_anchors, "hits_per_ray": float(hits.count.mean()), "psnr": psnr}


class FitWork:
    """Stages 1 and 2 from image and depth: canvas, placement, both solves, and the renders that note their PSNR."""

    def __init__(self, setting: Setting, backend: Backend, workshop: Workshop) -> None:
        self.config = config_for(setting.anchors, setting.mode, setting.width)
        self.inputs = workshop.inputs(setting.width)
        self.psnr: float | None = None
        self.anchors = 0

    def __call__(self, number: int) -> Sample:
        def fit() -> None:
            result = self.inputs.fit(self.config)
            self.psnr, self.anchors = float(result.record["input_psnr"]["final"]), result.scene.num_anchors

        return stopwatch(fit)

    def facts(self) -> dict[str, float | int | None]:
        return {"anchors": self.anchors, "psnr": self.psnr}


class StepWork:
    """Gradient steps of stage 2 (means fixed, all else trained) on batches of rays of both observations."""

    def __init__(self, setting: Setting, backend: Backend, workshop: Workshop) -> None:
        self.config = config_for(setting.anchors, setting.mode, setting.width)
        self.train = trainer(backend)
        inputs, self.generator = workshop.inputs(setting.width), torch.Generator().manual_seed(0)
        outpainter = Priors.of(self.config, ModelAccess(local_files_only=True), 0).outpainter
        depth = inputs.depth.depth
        canvas = make_canvas(inputs.image, depth, inputs.camera, inputs.views, self.config.canvas, outpainter)
        grid = place(canvas, self.config.planar)
        self.encoding = HashEncoding(rest_positions(canvas, grid), self.config.hash, self.generator)
        self.decoders = Decoders(generator=self.generator)
        start = planar_anchors(canvas, grid, self.config.planar)
        self.start = start.with_features(start.features + self.encoding().detach())
        self.observed = observations(canvas, _MARGIN_RESOLUTION)

    def __call__(self, number: int) -> Sample:
        marks: list[tuple[float, float]] = []
        self.train(
            self.start,
            self.decoders,
            self.encoding,
            self.observed,
            TrainPlan(1 + _STEPS, 0, train_means=False, train_extents=True),
            self.config.train,
            self.config.render,
            self.generator,
            lambda done, total: marks.append((time.perf_counter(), time.process_time())),
        )
        (wall, cpu), (wall_end, cpu_end) = marks[0], marks[-1]
        return Sample((wall_end - wall) / _STEPS, (cpu_end - cpu) / _STEPS)

    def facts(self) -> dict[str, float | int | None]:
        return {"anchors": len(self.start), "batch_rays": self.config.train.batch_rays}


class RepairWork:
    """Stage 3 of a fitted scene along eight views of the path."""

    def __init__(self, setting: Setting, backend: Backend, workshop: Workshop) -> None:
        self.config = config_for(setting.anchors, setting.mode, setting.width)
        self.scene = workshop.scene(setting.anchors, setting.mode)
        self.inputs = workshop.inputs(setting.width)
        step = max(1, len(self.inputs.views) // _REPAIR_VIEWS)
        self.views = self.inputs.views[step // 2 :: step][:_REPAIR_VIEWS]
        self.result: RepairResult | None = None

    def __call__(self, number: int) -> Sample:
        def run() -> None:
            planar = self.config.planar
            insert = InsertConfig(planar.kappa, planar.colour_clip)
            scene = self.scene
            self.result = repair(
                scene.anchors,
                scene.decoders,
                self.views,
                self.config.repair,
                self.config.render,
                insert,
                self.inputs.camera,
            )

        return stopwatch(run)

    def facts(self) -> dict[str, float | int | None]:
        if self.result is None:
            return {"anchors": self.scene.num_anchors}
        return {"anchors": len(self.result.anchors), "repairs": len(self.result.ledger.records)}
