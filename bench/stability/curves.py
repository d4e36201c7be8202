"""Quality against disturbance on a scene with true views: a real one of motorcycle, exact ones of synthetic scenes."""

from __future__ import annotations

import statistics
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from bench.adapters import METHODS, RunOptions
from bench.datasets import open_dataset
from bench.host import host_facts
from bench.metrics.fidelity import mean_squared_error, psnr_of_mse
from bench.progress import Reporter
from bench.stability.disturb import DISTURBANCES, disturbed, reduced, seed_of
from bench.stability.job import Done
from bench.stability.outcome import EXACT, Verdict, failed
from bench.stability.worker import Limits, Worker
from bench.store import read_json, write_json
from bench.trajectories import evenly_spaced
from orca.errors import BadInput

__all__ = ["EQUAL_DB", "SCENE", "CurveJob", "CurveRows", "check_scene", "run_curves", "seed_spread"]

SCENE = "photos/motorcycle"
FRAMES = 7  # of the path; it decides canvas and repairs, and is not what is measured
EQUAL_DB = 99.0  # stands for equal images
_LARGE = 400  # pixels a side: pictures that are larger are reduced, see `Disturbance.share`
VIEWS = ("input_psnr", "second_psnr")


@dataclass(frozen=True)
class CurveJob:
    """A method on a disturbed scene; the verdict's numbers are the PSNR of the true input and of the second view.

    Where a scene has several true views, the mean of theirs stands for the second.

    Attributes:
        kind: name of the disturbance.
        level: how much of it.
        method: name of the method.
        preset: preset of ORCA.
        scene: data set and scene.
    """

    kind: str
    level: float
    method: str
    preset: str = "draft"
    scene: str = SCENE
    leaves_traces: bool = False

    @property
    def name(self) -> str:
        """See `bench.stability.job.Job`."""
        return f"{self.kind} {self.level:g}/{self.method}"

    def run(self) -> Done:
        """See `bench.stability.job.Job`."""
        started = time.perf_counter()
        try:
            dataset, _, scene = self.scene.partition("/")
            case = open_dataset(dataset).load(scene)
            if min(case.image.shape[:2]) > _LARGE:
                case = reduced(case, DISTURBANCES[self.kind].share)
            case = replace(case, eval_indices=evenly_spaced(len(case.trajectory), FRAMES))
            told = disturbed(case, self.kind, self.level)
            started = time.perf_counter()
            options = RunOptions(preset=self.preset, seed=seed_of(self.kind, self.level))
            output = METHODS.get(self.method).run(told, options)
        except Exception as error:  # noqa: BLE001 - a failure is a point of the curve
            return Done(failed(error, "method"), time.perf_counter() - started)
        seconds = time.perf_counter() - started
        pairs = zip(output.true_views or (), told.true_views)
        psnr = [min(EQUAL_DB, psnr_of_mse(mean_squared_error(render, view.image))) for render, view in pairs]
        views = (psnr[0], statistics.fmean(psnr[1:])) if psnr[1:] else ()
        return Done(Verdict(EXACT, "", dict(zip(VIEWS, views))), seconds)


class CurveRows:
    """``curves.json`` in a folder: one row for each disturbance, level and method.

    Args:
        folder: of the run; made when the first row is written.
        scene: data set and scene that the rows are of.

    Raises:
        BadInput: the file that is there is not one of these, or of another scene.
    """

    def __init__(self, folder: Path, scene: str = SCENE) -> None:
        self.scene = scene
        self.path = Path(folder) / "curves.json"
        self._rows: dict[tuple[str, float, str], dict[str, Any]] = {}
        if self.path.is_file():
            try:
                document = read_json(self.path)
                if document.get("scene", SCENE) != scene:
                    raise ValueError(f"of the scene {document['scene']!r}, not {scene}")
                for row in document["rows"]:
                    key = row["disturbance"], 0.0 + row["level"], str(row["method"])
                    if key[0] not in DISTURBANCES:
                        raise ValueError(f"the disturbance {key[0]!r}")
                    self._rows[key] = dict(row, version=row["version"])
            except (KeyError, TypeError, ValueError, OverflowError) as error:
                raise BadInput(
                    f"{self.path} with a broken row ({error})", "what bench stability --curves writes", "another --out"
                ) from error

    def get(self, job: CurveJob, version: str) -> dict[str, Any] | None:
        """The row of a job, if it is of this version of the method."""
        row = self._rows.get((job.kind, job.level, job.method))
        return row if row is not None and row["version"] == version else None

    def add(self, job: CurveJob, version: str, values: dict[str, Any]) -> None:
        """Write the row of a job."""
        head = {"disturbance": job.kind, "level": job.level, "method": job.method, "version": version}
        self._rows[job.kind, job.level, job.method] = head | values
        write_json(self.path, {"schema_version": 1, "scene": self.scene, "rows": self.rows(), "machine": host_facts()})

    def rows(self) -> list[dict[str, Any]]:
        """All rows, by disturbance, method and level."""
        order = list(DISTURBANCES)
        keys = sorted(self._rows, key=lambda key: (order.index(key[0]), key[2], key[1]))
        return [self._rows[key] for key in keys]


def check_scene(text: str) -> None:
    """Whether a data set's scene can say what is right.

    Raises:
        BadInput: not a data set and a scene, or a scene without true views.
        Unknown: no such data set or scene.
    """
    dataset, slash, scene = text.partition("/")
    allowed, fix = "DATASET/SCENE with true views", f"leave it out for {SCENE}, or choose synthetic/predictable-00"
    if not slash:
        raise BadInput(f"the scene '{text}'", allowed, fix)
    if not open_dataset(dataset).load(scene).true_views:
        raise BadInput(f"the scene '{text}', which has no true view", allowed, fix)


def run_curves(
    kinds: Sequence[str],
    methods: Sequence[str],
    folder: Path,
    limits: Limits,
    preset: str,
    reporter: Reporter,
    scene: str = SCENE,
) -> CurveRows:
    """Compute what is missing, writing each point as it is known. Methods without chance get one seed.

    Raises:
        Unknown: no such method or disturbance.
        BadInput: the folder holds something else.
    """
    rows = CurveRows(folder, scene)
    versions = {method: METHODS.get(method).version(RunOptions(preset=preset)) for method in methods}
    jobs = [CurveJob(k, float(level), m, preset, scene) for k in kinds for m in methods for level in _levels(k, m)]
    reporter.start(len(jobs))
    try:
        with Worker(limits) as worker:
            for job in jobs:
                if rows.get(job, versions[job.method]) is not None:
                    reporter.cell(None)
                    continue
                reporter.phase(job.name, job.method, "run", 0, 1)
                report = worker.run(job)
                values: dict[str, Any] = {view: report.verdict.numbers.get(view) for view in VIEWS}
                values |= {"outcome": report.verdict.outcome, "detail": report.verdict.detail}
                values |= {"seconds": round(report.seconds, 3), "cpu_s": round(report.cpu_s, 3)}
                rows.add(job, versions[job.method], values | {"limits": asdict(limits)})
                shown = ", ".join(f"{view} {psnr:.2f} dB" for view, psnr in report.verdict.numbers.items())
                reporter.cell(f"{job.name}: {shown or report.verdict.detail}, {report.cpu_s:.1f} CPU-s")
    finally:
        reporter.close()
    return rows


def seed_spread(rows: Sequence[dict[str, Any]], method: str) -> dict[str, float]:
    """Sample standard deviation over the seeds of a method, in dB; empty with fewer than two seeds."""
    found = [row for row in rows if row["disturbance"] == "seed" and row["method"] == method]
    values = {view: [row[view] for row in found if row[view] is not None] for view in VIEWS}
    return {view: statistics.stdev(psnr) for view, psnr in values.items() if len(psnr) > 1}


def _levels(kind: str, method: str) -> tuple[float, ...]:
    """A warp draws no random number: one seed is all of them."""
    levels = DISTURBANCES[kind].levels
    return levels[:1] if kind == "seed" and method.startswith("warp") else levels
