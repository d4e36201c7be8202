"""A real Ray cluster of two nodes with a core each, on this machine, started and ended by these tests."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from bench.datasets.synthetic import Synthetic
from bench.executors import Resources
from bench.executors.local import LocalWorkers
from bench.executors.ray_cluster import RayCluster
from bench.progress import SilentReporter
from bench.request import RunRequest
from bench.runner import run_bench
from bench.store import RunStore
from orca.errors import BadInput, CannotWrite, Unavailable
from tests.bench.run_files import lasting, timed_out
from tests.bench.worker_fakes import METHODS, METRICS, calls, request_of
from tests.cluster import NEEDS, two_nodes

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def cluster() -> Iterator[str]:
    """The address of the cluster."""
    pytest.importorskip("ray")
    with two_nodes() as address:
        yield address


class Notes(SilentReporter):
    def __init__(self) -> None:
        self.notes: list[str] = []
        self.cells: list[str | None] = []

    def note(self, line: str) -> None:
        self.notes.append(line)

    def cell(self, line: str | None) -> None:
        self.cells.append(line)


def test_eight_scenes_by_two_workers_are_those_of_one_process(cluster: str, tmp_path: Path) -> None:
    dataset = Synthetic(size=64)
    scenes = tuple(dataset.scenes()[:8])
    one = RunRequest(dataset, scenes, ("warp", "warp-telea"), ("hole_fraction", "psnr"), tmp_path / "one")
    run_bench(one)
    two = replace(one, out=tmp_path / "two")
    told = Notes()
    summary = run_bench(two, told, executor=RayCluster(cluster, resources=NEEDS))
    assert (summary.computed, summary.failed) == (16, ())
    assert lasting(two.out) == lasting(one.out)
    assert len(told.cells) == 16
    assert run_bench(two, executor=RayCluster("nowhere:1", resources=NEEDS)).computed == 0


def test_any_mix_with_other_executors_gives_the_same_files(cluster: str, tmp_path: Path) -> None:
    serial = request_of(tmp_path / "serial")
    run_bench(serial, None, METHODS, METRICS)
    request = request_of(tmp_path / "mix")
    run_bench(replace(request, scenes=request.scenes[:1]), None, METHODS, METRICS)
    run_bench(replace(request, scenes=request.scenes[:3]), None, METHODS, METRICS, RayCluster(cluster, None, NEEDS))
    local = LocalWorkers(2, Resources(memory_gib=0.01))
    run_bench(replace(request, scenes=request.scenes[:4]), None, METHODS, METRICS, local)
    run_bench(request, None, METHODS, METRICS, RayCluster(cluster, 1, NEEDS))
    assert calls(tmp_path / "mix") == calls(tmp_path / "serial")
    assert lasting(request.out) == lasting(serial.out)


def test_a_lost_worker_is_tried_again_then_recorded(cluster: str, tmp_path: Path) -> None:
    request, told = request_of(tmp_path, count=3), Notes()
    (tmp_path / "brighter s00000").write_text("kill once")
    (tmp_path / "copy s00001").write_text("kill")
    summary = run_bench(request, told, METHODS, METRICS, RayCluster(cluster, None, NEEDS))
    assert summary.failed == (("copy", "s00001"),)
    record = RunStore(request.out).load("copy", "s00001")
    assert record is not None
    assert record.failure is not None
    assert record.failure.kind == "lost_worker"
    assert len(told.notes) == 3
    assert calls(tmp_path)["copy s00000"] == 1


def test_steps_that_take_too_long_are_failures_and_the_rest_goes_on(cluster: str, tmp_path: Path) -> None:
    """--cell-timeout: a method and a metric that sleep, and one that never returns from compiled code."""
    request = replace(request_of(tmp_path, count=3), cell_timeout=4.0)
    for step, how in {"copy s00000": "sleep", "grey s00001": "sleep", "brighter s00002": "spin"}.items():
        (tmp_path / step).write_text(how)
    told = Notes()
    run_bench(request, told, METHODS, METRICS, RayCluster(cluster, None, NEEDS))
    assert timed_out(request) == {"copy s00000", "brighter s00001 grey", "copy s00001 grey", "brighter s00002"}
    assert told.notes == []  # its process ended, but the step that it was lost at had been written down
    for step in ("copy s00000", "grey s00001", "brighter s00002"):
        (tmp_path / step).unlink()
    before = calls(tmp_path)
    again = run_bench(replace(request, retry_failed=True), None, METHODS, METRICS, RayCluster(cluster, None, NEEDS))
    assert (again.computed, again.failed) == (4, ())
    assert set(calls(tmp_path) - before) == {
        *("copy s00000", "brighter s00002", "grey s00000", "grey s00001", "grey s00002"),
    }


def test_what_no_scene_is_to_blame_for_ends_the_run(cluster: str, tmp_path: Path) -> None:
    request = request_of(tmp_path, count=2)
    (tmp_path / "copy s00001").write_text("full disk")
    with pytest.raises(CannotWrite, match="no room"):
        run_bench(request, None, METHODS, METRICS, RayCluster(cluster, None, NEEDS))


def test_a_scene_that_fits_no_machine_is_refused_at_once(cluster: str, tmp_path: Path) -> None:
    for needs in (Resources(cores=2), Resources(memory_gib=500), Resources(gpus=1, memory_gib=0.1)):
        with pytest.raises(BadInput, match=r"for a scene\n.*what one machine of the cluster has"):
            run_bench(request_of(tmp_path), None, METHODS, METRICS, RayCluster(cluster, None, needs))


def test_no_cluster_at_the_address_is_said(tmp_path: Path) -> None:
    with pytest.raises(Unavailable, match="no Ray cluster at 127"):
        run_bench(request_of(tmp_path), None, METHODS, METRICS, RayCluster("127.0.0.1:9", None, NEEDS))
