"""Several processes on one machine: the same files, each step once, and a lost process costs its step at most."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.executors import Executor, InThisProcess, Resources
from bench.executors.crew import fits, gpus_of
from bench.executors.local import LocalWorkers, share
from bench.executors.memory import available_gib
from bench.progress import BarReporter, SilentReporter
from bench.request import RunRequest
from bench.runner import RunSummary, run_bench
from bench.shard import parse_shard, scenes_of_shard
from bench.store import RunStore
from orca.errors import BadInput, CannotWrite, Unavailable
from tests.bench.run_files import lasting
from tests.bench.worker_fakes import METHODS, METRICS, calls, request_of

SMALL = Resources(memory_gib=0.01)


class Notes(SilentReporter):
    """Keeps what a run says."""

    def __init__(self) -> None:
        self.notes: list[str] = []
        self.phases: list[tuple[str, str, str]] = []
        self.over: list[str] = []

    def note(self, line: str) -> None:
        self.notes.append(line)

    def phase(self, scene: str, method: str, phase: str, done: int, total: int) -> None:
        self.phases.append((scene, method, phase))

    def scene_over(self, scene: str) -> None:
        self.over.append(scene)


def go(request: RunRequest, executor: Executor | None = None, told: Notes | None = None) -> RunSummary:
    return run_bench(request, told, METHODS, METRICS, executor)


@pytest.fixture(scope="module")
def serial(tmp_path_factory: pytest.TempPathFactory) -> RunRequest:
    """A run of one process, which others are compared with."""
    request = request_of(tmp_path_factory.mktemp("serial"))
    go(request)
    return request


def test_two_workers_write_what_one_process_writes(serial: RunRequest, tmp_path: Path) -> None:
    request, told = request_of(tmp_path), Notes()
    summary = go(request, LocalWorkers(2, SMALL), told)
    assert (summary.computed, summary.skipped, summary.failed) == (12, 0, ())
    assert lasting(request.out) == lasting(serial.out)
    assert sorted(told.over) == list(request.scenes)
    assert {phase for _, _, phase in told.phases} >= {"load", "fit", "metric Grey"}


@pytest.mark.slow
def test_any_mix_of_executors_goes_on_where_another_stopped(serial: RunRequest, tmp_path: Path) -> None:
    request = request_of(tmp_path)
    go(replace(request, scenes=request.scenes[:2]), LocalWorkers(2, SMALL))
    go(replace(request, scenes=request.scenes[:4]), InThisProcess())
    summary = go(request, LocalWorkers(2, SMALL))
    assert (summary.computed, summary.skipped) == (4, 8)
    assert set(calls(tmp_path).values()) == {1, 2}  # grey is asked of two methods
    assert all(n == 1 for call, n in calls(tmp_path).items() if not call.startswith("grey"))
    assert lasting(request.out) == lasting(serial.out)


def test_a_finished_run_starts_no_worker(serial: RunRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bench.executors.local.Crew", None)
    assert go(serial, LocalWorkers(2, SMALL)).computed == 0


@pytest.mark.slow
def test_a_lost_worker_costs_a_second_try_of_its_scene(serial: RunRequest, tmp_path: Path) -> None:
    request, told = request_of(tmp_path), Notes()
    (tmp_path / "brighter s00002").write_text("kill once")
    summary = go(request, LocalWorkers(2, SMALL), told)
    assert (summary.computed, summary.failed) == (11, ())  # copy on s00002 was finished before the loss
    assert calls(tmp_path)["brighter s00002"] == 2
    assert calls(tmp_path)["copy s00002"] == 1
    assert lasting(request.out) == lasting(serial.out)
    (line,) = told.notes
    assert "lost at s00002, brighter (killed by SIGKILL" in line
    assert "tried once more" in line


@pytest.mark.slow
def test_a_step_that_kills_its_worker_twice_is_a_failure_and_the_rest_goes_on(tmp_path: Path) -> None:
    request, told = request_of(tmp_path, count=3), Notes()
    (tmp_path / "copy s00001").write_text("kill")
    summary = go(request, LocalWorkers(2, SMALL), told)
    assert summary.failed == (("copy", "s00001"),)
    store = RunStore(request.out)
    lost, other = store.load("copy", "s00001"), store.load("brighter", "s00001")
    assert lost is not None
    assert lost.failure is not None
    assert lost.failure.kind == "lost_worker"
    assert "lost twice at s00001, copy: killed by SIGKILL" in lost.failure.message["given"]
    assert other is not None
    assert other.scores["grey"].value == 21.0
    assert ["recorded as failed" in line for line in told.notes] == [False, True]
    assert go(request, LocalWorkers(2, SMALL)).computed == 0
    (tmp_path / "copy s00001").unlink()
    assert go(replace(request, retry_failed=True), LocalWorkers(2, SMALL)).failed == ()


@pytest.mark.slow
def test_a_metric_that_kills_its_worker_fails_alone(tmp_path: Path) -> None:
    request = replace(request_of(tmp_path, count=1), methods=("copy",))
    (tmp_path / "grey s00000").write_text("kill")
    assert go(request, LocalWorkers(2, SMALL)).failed == (("copy", "s00000"),)
    record = RunStore(request.out).load("copy", "s00000")
    assert record is not None
    assert record.failure is None
    assert {key: score.status for key, score in record.scores.items()} == {"grey": "failed", "size": "ok"}
    assert "lost_worker" in str(record.scores["grey"].reason)
    assert calls(tmp_path)["copy s00000"] == 1


@pytest.mark.slow
def test_what_no_scene_is_to_blame_for_ends_the_run(tmp_path: Path) -> None:
    request = request_of(tmp_path, count=3)
    (tmp_path / "copy s00001").write_text("full disk")
    with pytest.raises(CannotWrite, match="no room"):
        go(request, LocalWorkers(2, SMALL))
    (tmp_path / "copy s00001").unlink()
    assert go(request, LocalWorkers(2, SMALL)).failed == ()


class _Broken(str):
    """Text whose reading fails in a new process."""

    def __reduce__(self) -> tuple[Any, ...]:
        return int, ("no number",)


@pytest.mark.slow
def test_workers_that_cannot_start_end_the_run_and_blame_no_scene(tmp_path: Path) -> None:
    request = request_of(tmp_path, count=2)
    with pytest.raises(Unavailable, match="a worker did not start: it ended with exit code 1"):
        go(replace(request, trajectory=_Broken("x")), LocalWorkers(2, SMALL))
    assert not RunStore(request.out).record_paths()


_SCRIPT = """
import signal
import sys
from pathlib import Path
from bench.executors import Resources
from bench.executors.local import LocalWorkers
from bench.runner import run_bench
from tests.bench.worker_fakes import METHODS, METRICS, request_of
if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs start without it
    try:
        run_bench(request_of(Path(sys.argv[1])), None, METHODS, METRICS, LocalWorkers(2, Resources(memory_gib=0.01)))
    except KeyboardInterrupt:
        sys.exit(130)
"""


def _children(parent: int) -> list[int]:
    found = []
    for status in Path("/proc").glob("[0-9]*/status"):
        try:
            lines = status.read_text().splitlines()
        except OSError:  # gone meanwhile
            continue
        if f"PPid:\t{parent}" in lines and "State:\tZ (zombie)" not in lines:
            found.append(int(status.parent.name))
    return found


def _until(true: Callable[[], Any], what: str, seconds: float = 120) -> None:
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end, f"{what} did not come"
        time.sleep(0.1)


@pytest.mark.slow
@pytest.mark.parametrize("how", ["Ctrl-C", "kill -9 of the first process"])
def test_nothing_is_left_running_and_nothing_is_lost(serial: RunRequest, tmp_path: Path, how: str) -> None:
    request = request_of(tmp_path)
    (tmp_path / "brighter s00001").write_text("sleep")
    (tmp_path / "copy s00003").write_text("sleep")
    script = tmp_path / "go.py"
    script.write_text(_SCRIPT)
    environment = {**os.environ, "PYTHONPATH": os.getcwd()}
    run = subprocess.Popen([sys.executable, str(script), str(tmp_path)], start_new_session=True, env=environment)
    try:
        _until(lambda: {"brighter s00001", "copy s00003"} <= set(calls(tmp_path)), "two busy workers")
        children = _children(run.pid)
        if how == "Ctrl-C":
            os.killpg(run.pid, signal.SIGINT)
            assert run.wait(60) == 130
        else:
            run.kill()
            run.wait(60)
        _until(lambda: not any(Path(f"/proc/{child}").exists() for child in children), "the end of the workers")
    finally:
        run.kill()
    before = calls(tmp_path)
    assert not list(request.out.rglob(".*~*"))
    for order in ("brighter s00001", "copy s00003"):
        (tmp_path / order).unlink()
    go(request)
    assert all((calls(tmp_path) - before)[call] == 0 for call in ("copy s00000", "brighter s00000", "copy s00001"))
    assert lasting(request.out) == lasting(serial.out)


def test_workers_are_as_many_as_memory_and_gpus_bear() -> None:
    assert share(4, 100, 8, 64.0, Resources(memory_gib=2)) == (4, 2, "")
    assert share(4, 3, 8, None, Resources(memory_gib=2)) == (3, 2, "")
    assert share(4, 100, 8, 5.0, Resources(memory_gib=2)) == (
        2,
        4,
        "2 of 4 workers: 5.0 GiB are available and a scene is given 2",
    )
    assert share(4, 100, 8, 1.0, Resources(memory_gib=2))[:2] == (1, 8)
    assert share(4, 100, 8, 64.0, Resources(cores=3, gpus=1), gpus=2)[:2] == (2, 3)
    assert share(4, 100, 8, 64.0, Resources(gpus=0.5), gpus=2)[2] == ""


@given(st.integers(1, 64), st.integers(1, 64), st.integers(1, 128), st.floats(0, 512), st.floats(0.1, 64))
def test_shares_never_exceed_what_there_is(jobs: int, scenes: int, cores: int, gib: float, need: float) -> None:
    workers, threads, words = share(jobs, scenes, cores, gib, Resources(memory_gib=need))
    assert 1 <= workers <= min(jobs, scenes)
    assert workers == 1 or workers * need <= gib
    assert threads == 1 or workers * threads <= cores
    assert bool(words) == (workers < min(jobs, scenes) or int(gib / need) < 1)


def test_a_scene_starts_when_what_others_will_still_take_leaves_room() -> None:
    assert fits(2.0, 0.0, [], 0.1)  # nobody works: there is no better time
    assert fits(2.0, 0.0, [0.5], 3.5)
    assert not fits(2.0, 0.0, [0.5], 3.4)
    assert fits(2.0, 0.5, [0.5], 3.0)  # the worker that would take it holds some already
    assert fits(2.0, 0.0, [3.0], 2.0)  # the other has all it will take, and more
    assert fits(2.0, 0.0, [0.5], None)


def test_gpus_are_given_out_whole_or_shared() -> None:
    assert [gpus_of(i, 1, "abc") for i in range(3)] == [("a",), ("b",), ("c",)]
    assert [gpus_of(i, 2, "abcd") for i in range(2)] == [("a", "b"), ("c", "d")]
    assert [gpus_of(i, 0.5, "ab") for i in range(4)] == [("a",), ("a",), ("b",), ("b",)]
    assert gpus_of(0, 0, "ab") == ()


def test_memory_is_the_machines_or_the_containers(tmp_path: Path) -> None:
    assert available_gib(tmp_path) is None
    (tmp_path / "proc").mkdir()
    (tmp_path / "proc/meminfo").write_text("MemTotal: 9 kB\nMemAvailable:    8388608 kB\n")
    assert available_gib(tmp_path) == 8.0
    group = tmp_path / "sys/fs/cgroup"
    group.mkdir(parents=True)
    (group / "memory.max").write_text("max\n")
    (group / "memory.current").write_text(f"{3 * 2**30}\n")
    (group / "memory.stat").write_text(f"anon 5\ninactive_file {2**30}\n")
    assert available_gib(tmp_path) == 8.0
    (group / "memory.max").write_text(f"{4 * 2**30}\n")
    assert available_gib(tmp_path) == 2.0


def test_the_bar_shows_every_worker(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    bar = BarReporter()
    bar.start(4)
    bar.phase("a", "orca", "fit", 0, 500)
    bar.phase("b", "warp", "metric Tsed", 0, 1)
    assert "a · orca · fit 0/500 | b · warp · metric Tsed" in capsys.readouterr().err
    bar.scene_over("a")
    bar.phase("b", "warp", "metric Niqe", 0, 1)
    bar.close()
    last = capsys.readouterr().err
    assert "b · warp · metric Niqe" in last
    assert "orca" not in last


@pytest.mark.parametrize("text", ["0/2", "3/2", "1", "a/b", "1/0", "-1/2", "1/2/3", ""])
def test_a_shard_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(BadInput, match="I/N with 1 <= I <= N"):
        parse_shard(text)


@given(st.lists(st.text(min_size=1, max_size=4), unique=True), st.integers(1, 12), st.data())
def test_shards_are_disjoint_complete_even_and_deaf_to_what_else_is_asked(
    known: list[str], parts: int, data: st.DataObject
) -> None:
    whole = [scenes_of_shard(known, known, (part, parts)) for part in range(1, parts + 1)]
    assert sorted(scene for part in whole for scene in part) == sorted(known)
    assert max(map(len, whole)) - min(map(len, whole)) <= 1
    asked = data.draw(st.lists(st.sampled_from(known), unique=True)) if known else []
    for i, part in enumerate(whole):
        assert set(scenes_of_shard(asked, known, (i + 1, parts))) == set(part) & set(asked)


@pytest.mark.parametrize("wrong", [{"cores": 0}, {"memory_gib": 0.0}, {"memory_gib": float("nan")}, {"gpus": -1.0}])
def test_resources_that_make_no_sense_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(BadInput, match="for a scene"):
        Resources(**wrong)
    with pytest.raises(BadInput, match="--jobs 0"):
        LocalWorkers(0)
