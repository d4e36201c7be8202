"""What is killed: a bench run of fakes from start to tables."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pyarrow.parquet  # noqa: F401 - once, before the forks

import bench.timelimit
import orca.atomic
from bench.datasets import SceneCase
from bench.executors import Resources
from bench.executors.local import LocalWorkers
from bench.measured import read_runs
from bench.provenance import code_state
from bench.runner import RunRequest, run_bench
from bench.tables import scene_table, write_tables
from orca.images import load_image
from tests.bench import spine_fakes as fakes

__all__ = ["METHODS", "METRICS", "bench_job"]

code_state()  # likewise
METHODS = ("dark", "light")
METRICS = ("bright", "covered", "only_a")


@dataclass
class FromFiles(fakes.FakeDataset):
    """The fake scenes, each of which needs an image file."""

    folder: str = ""

    def load(self, scene: str) -> SceneCase:
        load_image(Path(self.folder) / f"{scene}.png")
        return super().load(scene)


def bench_job(
    out: str,
    metrics: tuple[str, ...] = METRICS,
    scenes: tuple[str, ...] = ("a", "b"),
    switches: dict[str, str] | None = None,
    log_points: bool = False,
    retry_failed: bool = False,
    cell_timeout: float | None = None,
    grace: float = 1.0,
    images: str | None = None,
    workers: int = 0,
) -> dict[str, Any]:
    """What `bench run` does after its command line was read: run, then tables.

    Returns:
        How often each fake was called, the failed cells, and the write points that were passed, as [step, path].
    """
    fakes.reset()
    fakes.SWITCHES.update(switches or {})
    points = _logged_points() if log_points else []
    bench.timelimit.GRACE_S = grace
    dataset = fakes.FakeDataset() if images is None else FromFiles(folder=images)
    request = RunRequest(dataset, tuple(scenes), METHODS, tuple(metrics), Path(out))
    request = replace(request, retry_failed=retry_failed, cell_timeout=cell_timeout)
    executor = LocalWorkers(workers, Resources(memory_gib=0.01)) if workers else None
    summary = run_bench(request, methods=fakes.METHODS, metrics=fakes.METRICS, executor=executor)
    write_tables(Path(out) / "tables", (scene_table(read_runs([Path(out)])),))
    return {"calls": dict(fakes.CALLS), "failed": summary.failed, "points": points}


def _logged_points() -> list[tuple[str, str]]:
    points: list[tuple[str, str]] = []

    def logged(step: str, target: Path, unfinished: Path | None = None) -> None:
        points.append((step, str(target)))

    orca.atomic.fault_point = logged
    return points
