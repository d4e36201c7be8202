"""SLURM through submitit, with the executor of submitit that runs jobs on this machine."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from bench.executors import Resources
from bench.executors.slurm import Slurm, parse_options
from bench.progress import SilentReporter
from bench.runner import run_bench
from bench.store import RunStore
from orca.errors import BadInput, CannotWrite, Unavailable
from tests.bench.run_files import lasting, timed_out
from tests.bench.worker_fakes import METHODS, METRICS, calls, request_of

HERE = Slurm(2, Resources(memory_gib=0.1), {"cluster": "local"})


@pytest.mark.slow
def test_jobs_go_on_where_one_process_stopped_and_a_lost_one_is_tried_again(tmp_path: Path) -> None:
    serial = request_of(tmp_path / "serial", count=3)
    run_bench(serial, None, METHODS, METRICS)
    request = request_of(tmp_path / "jobs", count=3)
    run_bench(replace(request, scenes=request.scenes[:1]), None, METHODS, METRICS)
    (tmp_path / "jobs" / "brighter s00002").write_text("kill once")
    summary = run_bench(request, SilentReporter(), METHODS, METRICS, HERE)
    assert (summary.computed, summary.skipped, summary.failed) == (3, 3, ())
    assert calls(tmp_path / "jobs")["copy s00002"] == 1
    assert calls(tmp_path / "jobs")["brighter s00002"] == 2
    assert lasting(request.out, also=("slurm",)) == lasting(serial.out)
    record = RunStore(request.out).load("copy", "s00002")
    assert record is not None
    assert record.host["threads"] == 1


@pytest.mark.slow
def test_steps_that_take_too_long_are_failures_and_the_rest_goes_on(tmp_path: Path) -> None:
    """--cell-timeout: a method and a metric that sleep."""
    request = replace(request_of(tmp_path, count=2), cell_timeout=4.0)
    for step in ("copy s00000", "grey s00001"):
        (tmp_path / step).write_text("sleep")
    run_bench(request, None, METHODS, METRICS, HERE)
    assert timed_out(request) == {"copy s00000", "brighter s00001 grey", "copy s00001 grey"}
    for step in ("copy s00000", "grey s00001"):
        (tmp_path / step).unlink()
    before = calls(tmp_path)
    again = run_bench(replace(request, retry_failed=True), None, METHODS, METRICS, HERE)
    assert (again.computed, again.failed) == (3, ())
    assert set(calls(tmp_path) - before) == {"copy s00000", "grey s00000", "grey s00001"}


@pytest.mark.slow
def test_what_no_scene_is_to_blame_for_ends_the_run(tmp_path: Path) -> None:
    request = request_of(tmp_path, count=1)
    (tmp_path / "copy s00000").write_text("full disk")
    with pytest.raises(CannotWrite, match="no room"):
        run_bench(request, None, METHODS, METRICS, HERE)


def test_options_are_read_and_wrong_ones_refused(tmp_path: Path) -> None:
    assert parse_options(["slurm_partition=gpu", "timeout_min=20"]) == {"slurm_partition": "gpu", "timeout_min": 20}
    for text in ("gpu", "=gpu", "a b=c", "time="):
        with pytest.raises(BadInput, match="KEY=VALUE"):
            parse_options([text])
    for options in ({"colour": "red"}, {"slurm_colour": "red"}, {"timeout_min": "soon"}):
        with pytest.raises(BadInput, match="--slurm: "):
            run_bench(request_of(tmp_path), None, METHODS, METRICS, replace(HERE, options={**HERE.options, **options}))


def test_without_slurm_it_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(Unavailable, match="no cluster 'slurm'"):
        run_bench(request_of(tmp_path), None, METHODS, METRICS, Slurm())
