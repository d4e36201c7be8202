"""Real scenes, one process each: stages 1 and 2 with an anchor per four pixels and per pixel, and the whole method.

Every row is measured in a process of its own, so that its peak memory is its own. A small copy of the scene goes
through the same stages first: that loads the compiled kernels.
"""

from __future__ import annotations

import logging
import multiprocessing
import statistics
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import cv2
import numpy as np

from bench.datasets.case import SceneCase
from bench.speed.memory import own_peak_mb
from bench.speed.threads import limited_to
from bench.speed.workshop import Inputs
from bench.tableformat import Head, Row, Table, TableCell
from orca.config import PRESETS, ReconstructConfig
from orca.conventions import to_float
from orca.pipeline import Reconstruction, reconstruct
from orca.priors.depth import DepthEstimate

__all__ = ["FITS", "SceneJob", "SceneRow", "inputs_of", "measure_scenes", "measured", "scenes_table"]

FITS = ("draft", "quality")
"""Presets that are fitted: 65,536 and 262,144 anchors inside an image of 512 x 512."""

_SMALL = 64  # side of the copy that loads the kernels, in pixels
_STAGES = ("canvas", "planar", "deform", "repair")

Case = Literal["fit", "reconstruct"]


@dataclass(frozen=True, eq=False)
class SceneJob:
    """One row to measure.

    Attributes:
        scene: its name.
        inputs: what the reconstruction starts from.
        case: "fit" is stages 1 and 2 with the canvas; "reconstruct" is the whole method, repair included.
        preset: of the method.
        threads: of numba, torch and OpenCV.
        repeats: how often; medians count.
    """

    scene: str
    inputs: Inputs
    case: Case
    preset: str
    threads: int
    repeats: int

    @property
    def config(self) -> ReconstructConfig:
        """The preset, without repair for a fit."""
        config = PRESETS[self.preset]
        return replace(config, repair=replace(config.repair, enabled=False)) if self.case == "fit" else config


@dataclass(frozen=True)
class SceneRow:
    """What was measured.

    Attributes:
        case, scene, threads: see `SceneJob`.
        backend, mode: "fast" and how hits are decoded.
        anchors: how many were asked for inside the image; ``placed`` in the end, margin and repairs included.
        width: of the image in pixels.
        wall_ms, cpu_ms: medians of stages 1 and 2 with the canvas, or of all; CPU time is that of all threads.
        peak_mb: largest resident set of the process, see `bench.speed.memory`; None if the system does not say.
        psnr: of the input view in the end, dB.
        seconds: wall time by stage, of the median repeat.
    """

    case: str
    backend: str
    mode: str
    scene: str
    anchors: int
    placed: int
    width: int
    threads: int
    repeats: int
    wall_ms: float
    cpu_ms: float
    peak_mb: float | None
    psnr: float
    seconds: dict[str, float]

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self)


def inputs_of(case: SceneCase) -> Inputs:
    """What ORCA reconstructs a scene of a data set from."""
    depth = DepthEstimate(case.depth, case.depth_source, case.depth_is_metric, is_measured=case.depth_is_measured)
    return Inputs(to_float(case.image), case.camera, depth, tuple(case.eval_trajectory.cameras()))


def measure_scenes(
    cases: Sequence[SceneCase], threads: int, quick: bool, done: Callable[[SceneRow], None] = lambda row: None
) -> list[SceneRow]:
    """Rows of some scenes; ``quick`` leaves the whole method out and fits once instead of three times."""
    rows = []
    for case in cases:
        inputs, repeats = inputs_of(case), 1 if quick else 3
        jobs = [SceneJob(case.name, inputs, "fit", preset, threads, repeats) for preset in FITS]
        jobs += [] if quick else [SceneJob(case.name, inputs, "reconstruct", "draft", threads, 1)]
        for job in jobs:
            with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
                rows.append(pool.submit(_in_a_process, job).result())
            done(rows[-1])
    return rows


def measured(job: SceneJob) -> SceneRow:
    """Do a job in this process, whose peak memory so far is the row's."""
    with limited_to(job.threads):
        _run(job.config, _shrunk(job.inputs))
        results = []
        for _ in range(job.repeats):
            wall, cpu = time.perf_counter(), time.process_time()
            result = _run(job.config, job.inputs)
            results.append((time.perf_counter() - wall, time.process_time() - cpu, result.record["seconds"]))
    pixels = job.inputs.image.shape[0] * job.inputs.image.shape[1]
    return SceneRow(
        case=job.case,
        backend="fast",
        mode=job.config.render.decode,
        scene=job.scene,
        anchors=round(job.config.planar.anchors_per_pixel * pixels),
        placed=result.scene.num_anchors,
        width=job.inputs.image.shape[1],
        threads=job.threads,
        repeats=job.repeats,
        wall_ms=1e3 * statistics.median(r[0] for r in results),
        cpu_ms=1e3 * statistics.median(r[1] for r in results),
        peak_mb=own_peak_mb(),
        psnr=float(result.record["input_psnr"]["final"]),
        seconds=dict(sorted(results, key=lambda r: r[0])[len(results) // 2][2]),
    )


def _in_a_process(job: SceneJob) -> SceneRow:
    logging.disable(logging.WARNING)  # the parent has said it
    return measured(job)


def _run(config: ReconstructConfig, inputs: Inputs) -> Reconstruction:
    return reconstruct(inputs.image, inputs.camera, inputs.depth, inputs.views, config)


def _shrunk(inputs: Inputs) -> Inputs:
    """A small copy, of the same form."""
    size = (_SMALL, _SMALL)
    depth = cv2.resize(inputs.depth.depth, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    image = cv2.resize(inputs.image, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    views = tuple(view.resized(*size) for view in inputs.views)
    return Inputs(image, inputs.camera.resized(*size), replace(inputs.depth, depth=depth), views)


def scenes_table(rows: Sequence[SceneRow]) -> Table:
    """All rows, a group a scene."""
    heads = (
        Head("wall_ms", "Wall [s]"),
        Head("cpu_ms", "CPU [s]"),
        *(Head(stage, f"{stage.capitalize()} [s]") for stage in _STAGES),
        Head("peak_mb", "Peak [MB]"),
        Head("psnr", "PSNR"),
        Head("placed", "Placed"),
    )
    lines = []
    for i, row in enumerate(rows):
        values = (row.wall_ms / 1e3, row.cpu_ms / 1e3, *(row.seconds[stage] for stage in _STAGES))
        peak = TableCell("-") if row.peak_mb is None else TableCell(f"{row.peak_mb:.0f}", row.peak_mb)
        cells = (
            *(TableCell(f"{value:.2f}", value) for value in values),
            peak,
            TableCell(f"{row.psnr:.2f}", row.psnr),
            TableCell(str(row.placed), row.placed),
        )
        labels = (row.scene, row.case, str(row.anchors), str(row.width), str(row.threads))
        lines.append(Row(labels, cells, group_start=i == 0 or rows[i - 1].scene != row.scene))
    notes = (
        "fit: stages 1 and 2 with the canvas, medians; reconstruct: all three stages, once, along the data set's path.",
        "Peak: largest resident set of a process of its own, libraries included (about 600 MB before any work).",
    )
    labels = ("Scene", "Case", "Anchors", "Width", "Threads")
    return Table("scenes", "Whole scenes", labels, heads, tuple(lines), notes)
