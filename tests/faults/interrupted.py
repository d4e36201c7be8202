"""Ctrl-C, as a terminal sends it: to every process of the run at once."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from tests.faults.forks import ONE_THREAD
from tests.faults.snapshot import finished_cells
from tests.faults.workbench import Told, Workbench

__all__ = ["ctrl_c"]

_CTRL_C = """
import signal, sys
import bench.cli
from bench.commands.outcome import Outcome
from tests.faults.jobs import bench_job
def call(args):
    bench_job(sys.argv[1], switches={"light a": "hang"}, workers=int(sys.argv[2]))
    return Outcome("", {}, 0)
if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs start without it
    bench.cli._call = call
    sys.exit(bench.cli.main(["run"]))
"""
_PROMISE = "interrupted: finished work is kept, the same command goes on from here"
_PAUSE_S = 0.02  # between the first and the second


def ctrl_c(times: int, workers: int = 0) -> Callable[[Workbench], Told]:
    """Interrupt a run while a method hangs, once or twice in a row."""

    def scenario(bench: Workbench) -> Told:
        wanted = bench.whole()
        run = _started(bench, workers)
        end = time.monotonic() + 300
        while not _under_way(bench.out):
            if time.monotonic() > end or run.poll() is not None:
                os.killpg(run.pid, signal.SIGKILL)
                return Told(f"it never began: {run.communicate()[1][-300:]!r}", ("everything",))
            time.sleep(0.05)
        for _ in range(times):
            with suppress(ProcessLookupError):
                os.killpg(run.pid, signal.SIGINT)
            time.sleep(_PAUSE_S)
        said = run.communicate()[1].decode()
        left = _still_there(run.pid)
        promised = _PROMISE in said
        lost = [f"{left} processes are left"] if left else []
        if run.returncode not in (130, -signal.SIGINT) or (times == 1 and not promised):
            lost.append(f"exit code {run.returncode}: {said[-300:]!r}")
        how = f"exit code {run.returncode}" if run.returncode >= 0 else f"ended by signal {-run.returncode}"
        says = f'"{_PROMISE}"' if promised else "nothing of it"
        return Told(f"{how}, says {says}; {left} processes left", (*lost, *bench.lost_after(wanted)))

    return scenario


def _started(bench: Workbench, workers: int) -> subprocess.Popen[bytes]:
    root = Path(__file__).resolve().parents[2]
    script = bench.folder / "interrupted.py"
    script.write_text(_CTRL_C)  # a file, which workers can import again
    return subprocess.Popen(
        [sys.executable, str(script), str(bench.out), str(workers)],
        cwd=root,
        env={**os.environ, **ONE_THREAD, "PYTHONPATH": str(root)},
        stderr=subprocess.PIPE,
        start_new_session=True,
    )


def _under_way(out: Path) -> bool:
    """Whether the scene before the one that hangs has all of its scores."""
    return finished_cells(out).get(("dark", "a")) == {"bright", "brightest", "covered", "only_a"}


def _still_there(group: int) -> int:
    """Processes of the group that live ten seconds later; then they are ended."""
    end = time.monotonic() + 10
    while members := _members(group):
        if time.monotonic() > end:
            os.killpg(group, signal.SIGKILL)
            return len(members)
        time.sleep(0.1)
    return 0


def _members(group: int) -> list[str]:
    found = []
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = status.read_text().rpartition(")")[2].split()
        except OSError:  # gone meanwhile
            continue
        if fields[2] == str(group) and fields[0] != "Z":
            found.append(status.parent.name)
    return found
