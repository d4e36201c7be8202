"""Go through a plan: time each setting's backends in turns, then measure memory, and make rows of it."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from bench.speed.case import Backend, Setting
from bench.speed.memory import peak_mb
from bench.speed.threads import limited_to
from bench.speed.timing import Sample, Timing, alternate, paired_ratio
from bench.speed.trainers import trained_backends
from bench.speed.works import FrameWork, Work, build_work
from bench.speed.workshop import Workshop

__all__ = ["Ratio", "SpeedRow", "measure", "measure_setting"]

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class SpeedRow:
    """One backend of one setting.

    Attributes:
        case, backend, mode, anchors, width, threads: see `Setting`; ``anchors`` is the number asked for.
        wall_ms, cpu_ms: medians of the rounds; CPU time is that of all threads.
        wall_ms_q25, wall_ms_q75: quartiles of the rounds: the spread.
        repeats: how many rounds counted.
        peak_mb: see `bench.speed.memory`; None where it was not measured.
        psnr: of the input view in dB, for a fit and for frames of the size the scene was fitted at.
        facts: anchors there were ("anchors"), "hits_per_ray", "repairs", "batch_rays", where they apply.
    """

    case: str
    backend: str
    mode: str
    anchors: int
    width: int
    threads: int
    wall_ms: float
    cpu_ms: float
    peak_mb: float | None
    psnr: float | None
    wall_ms_q25: float
    wall_ms_q75: float
    repeats: int
    facts: dict[str, float | int | None]

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self)


@dataclass(frozen=True)
class Ratio:
    """Reference over fast of one setting, round by round.

    Attributes:
        wall, wall_low, wall_high: median, least and largest ratio of wall times.
        cpu: median ratio of CPU times.
        largest_difference: of any channel of any pixel of one frame, for frames.
    """

    case: str
    mode: str
    anchors: int
    width: int
    threads: int
    wall: float
    wall_low: float
    wall_high: float
    cpu: float
    largest_difference: float | None

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self)


def measure(
    plan: Iterable[Setting], workshop: Workshop, done: Callable[[list[SpeedRow]], None] = lambda rows: None
) -> tuple[list[SpeedRow], list[Ratio]]:
    """All rows and ratios of a plan; ``done`` hears the rows of each setting as they come, so that none is lost."""
    rows: list[SpeedRow] = []
    ratios: list[Ratio] = []
    for setting in plan:
        new, ratio = measure_setting(setting, workshop)
        rows += new
        ratios += [ratio] if ratio else []
        done(rows)
    return rows, ratios


def measure_setting(setting: Setting, workshop: Workshop) -> tuple[list[SpeedRow], Ratio | None]:
    """The rows of one setting and, if two backends ran, their ratio."""
    backends = [b for b in setting.backends if setting.case != "step" or b in trained_backends()]
    with limited_to(setting.threads):
        works = {backend: build_work(setting, backend, workshop) for backend in backends}
        samples = alternate(works, setting.patience)
        rows = [_row(setting, backend, samples[backend], works[backend].facts(), workshop) for backend in backends]
    for row in rows:
        _log.info(
            "%s %s %s, %d anchors, %d px, %d threads: %.1f ms",
            row.case,
            row.mode,
            row.backend,
            row.anchors,
            row.width,
            row.threads,
            row.wall_ms,
        )
    return rows, _ratio(setting, samples, works)


def _row(
    setting: Setting,
    backend: Backend,
    samples: list[Sample],
    facts: dict[str, float | int | None],
    workshop: Workshop,
) -> SpeedRow:
    timing, peak = Timing.of(samples), None
    if backend in setting.measure_memory:
        peak = peak_mb(setting, backend, workshop.folder, workshop.base_width)
    return SpeedRow(
        case=setting.case,
        backend=backend,
        mode=setting.mode,
        anchors=setting.anchors,
        width=setting.width,
        threads=setting.threads,
        wall_ms=timing.wall_ms,
        cpu_ms=timing.cpu_ms,
        peak_mb=peak,
        psnr=facts.pop("psnr", None),
        wall_ms_q25=timing.wall_ms_q25,
        wall_ms_q75=timing.wall_ms_q75,
        repeats=timing.repeats,
        facts=facts,
    )


def _ratio(setting: Setting, samples: dict[Backend, list[Sample]], works: dict[Backend, Work]) -> Ratio | None:
    if not {"fast", "reference"} <= set(samples):
        return None
    where = (setting.case, setting.mode, setting.anchors, setting.width, setting.threads)
    return Ratio(*where, *paired_ratio(samples["reference"], samples["fast"]), _difference(works))


def _difference(works: dict[Backend, Work]) -> float | None:
    """Both backends' last frames are of one camera."""
    fast, slow = works["fast"], works["reference"]
    if not (isinstance(fast, FrameWork) and isinstance(slow, FrameWork)) or fast.rgb is None or slow.rgb is None:
        return None
    return float(np.abs(fast.rgb - slow.rgb).max())
