"""The worker of `bench stability`: deaths, limits, and who is to blame."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench.stability.outcome import CRASH, EXACT, OUT_OF_MEMORY, TIME_OUT
from bench.stability.worker import Limits, Worker
from tests.bench.stability_jobs import DyingJob, GreedyJob, OnceJob, SleepingJob, SpinningJob, WellJob


@pytest.mark.slow
def test_a_death_is_a_crash_and_the_next_job_lives() -> None:
    with Worker(Limits()) as worker:
        first = worker.run(WellJob())
        again = worker.run(WellJob())
        assert first.verdict == again.verdict, "one process serves many jobs"
        dead = worker.run(DyingJob())
        assert dead.verdict.outcome == CRASH
        assert "killed by SIGSEGV" in dead.verdict.detail
        assert "last words" in dead.verdict.detail
        after = worker.run(WellJob())
        assert after.verdict.outcome == EXACT
        assert after.verdict.detail != first.verdict.detail


@pytest.mark.slow
def test_nobody_is_blamed_for_what_an_earlier_job_left_behind(tmp_path: Path) -> None:
    with Worker(Limits()) as worker:
        worker.run(WellJob("the culprit"))
        report = worker.run(OnceJob(tmp_path / "mark"))
        assert report.verdict.outcome == EXACT
        assert "that had done the culprit before died on it" in report.verdict.detail
        assert "SIGKILL" in report.verdict.detail


@pytest.mark.slow
def test_working_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bench.stability.worker.WAITING", 1e6)  # the clock of a busy machine says nothing
    with Worker(Limits(seconds=0.3, memory_mb=1e6)) as worker:
        report = worker.run(SpinningJob())
    assert (report.verdict.outcome, report.verdict.detail) == (TIME_OUT, "not done after 0.3 s of CPU time")
    assert report.cpu_s > 0.3


@pytest.mark.slow
def test_waiting_for_ever() -> None:
    with Worker(Limits(seconds=0.2, memory_mb=1e6)) as worker:
        report = worker.run(SleepingJob())
    assert report.verdict.outcome == TIME_OUT
    assert "by the clock" in report.verdict.detail


@pytest.mark.slow
def test_taking_all_memory() -> None:
    with Worker(Limits(seconds=600, memory_mb=1000)) as worker:
        report = worker.run(GreedyJob())
    assert report.verdict.outcome == OUT_OF_MEMORY
    assert report.peak_mb is not None
    assert report.peak_mb > 1000


@pytest.mark.slow
def test_a_job_that_leaves_traces_is_the_last_of_its_process() -> None:
    with Worker(Limits()) as worker:
        marked = worker.run(WellJob(leaves_traces=True))
        after = worker.run(WellJob())
        assert marked.verdict.detail != after.verdict.detail
