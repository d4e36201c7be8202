"""What is killed: a bench run of fakes from start to tables."""

from __future__ import annotations

import ctypes
import json
import logging
import os
import struct
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
from bench.progress import SilentReporter
from bench.provenance import code_state
from bench.runner import RunRequest, run_bench
from bench.tables import scene_table, write_tables
from orca.images import load_image
from tests.bench import spine_fakes as fakes

__all__ = ["METHODS", "METRICS", "bench_job", "heed_permissions"]

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
    as_anybody: bool = False,
) -> dict[str, Any]:
    """What `bench run` does after its command line was read: run, then tables.

    Returns:
        How often each fake was called in this process, the failed cells, the number of computed ones, the write points
        that were passed, as [step, path], what the run said of its workers, and what it warned of.
    """
    fakes.reset()
    fakes.SWITCHES.update(switches or {})
    os.environ[fakes.VARIABLE] = json.dumps(switches or {})
    if as_anybody:
        heed_permissions()
    told = _Notes()
    logging.getLogger("bench").addHandler(told.warnings)
    points = _logged_points() if log_points else []
    bench.timelimit.GRACE_S = grace
    dataset = fakes.FakeDataset() if images is None else FromFiles(folder=images)
    request = RunRequest(dataset, tuple(scenes), METHODS, tuple(metrics), Path(out))
    request = replace(request, retry_failed=retry_failed, cell_timeout=cell_timeout)
    executor = LocalWorkers(workers, Resources(cores=1, memory_gib=0.01)) if workers else None
    summary = run_bench(request, told, fakes.METHODS, fakes.METRICS, executor)
    write_tables(Path(out) / "tables", (scene_table(read_runs([Path(out)])),))
    said = {"notes": told.notes, "warnings": told.warnings.lines}
    return {
        "calls": dict(fakes.CALLS),
        "failed": summary.failed,
        "computed": summary.computed,
        "points": points,
        **said,
    }


class _Notes(SilentReporter):
    """Keeps what a run says."""

    def __init__(self) -> None:
        self.notes: list[str] = []
        self.warnings = _Warnings(logging.WARNING)

    def note(self, line: str) -> None:
        self.notes.append(line)


class _Warnings(logging.Handler):
    def __init__(self, level: int) -> None:
        super().__init__(level)
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.lines.append(record.getMessage())


def heed_permissions() -> None:
    """From now on this process may not write where its owner may not, even if that is root (CAP_DAC_OVERRIDE)."""
    libc = ctypes.CDLL(None, use_errno=True)
    header, sets = struct.pack("Ii", 0x20080522, 0), ctypes.create_string_buffer(24)  # version 3, this process
    if libc.capget(header, sets):
        raise OSError(ctypes.get_errno(), "capget")
    words = list(struct.unpack("6I", sets.raw))  # effective, permitted, inheritable, and the same of later ones
    for which in (0, 1):
        words[which] &= ~0b110  # CAP_DAC_OVERRIDE and CAP_DAC_READ_SEARCH
    if libc.capset(header, struct.pack("6I", *words)):
        raise OSError(ctypes.get_errno(), "capset")


def _logged_points() -> list[tuple[str, str]]:
    points: list[tuple[str, str]] = []

    def logged(step: str, target: Path, unfinished: Path | None = None) -> None:
        points.append((step, str(target)))

    orca.atomic.fault_point = logged
    return points
