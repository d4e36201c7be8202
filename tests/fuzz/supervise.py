"""One process of the engine: its time of computing counted, held still while a file says so, ended when time is up."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from tests.fuzz.target import folder

__all__ = ["Ended", "artifact_repeats", "cpu_seconds_of", "supervise"]

_LOOK_S = 0.5
_TICKS = os.sysconf("SC_CLK_TCK")
_ALONE_S = 60  # of computing, for one input run again by itself


@dataclass(frozen=True)
class Ended:
    """How a process of the engine ended.

    Attributes:
        executions: inputs run, the corpus that it began with among them.
        cpu_seconds: of computing after its start-up (imports, compilation), children that it waited for included.
        crashed: it ended before its time.
    """

    executions: int
    cpu_seconds: float
    crashed: bool


def supervise(command: list[str], cpu_seconds: float, log: Path, pause: Path | None = None) -> Ended:
    """Run the engine until it has computed for so long.

    Args:
        command: what to start; prints ``ready: SECONDS`` when its start-up is done.
        cpu_seconds: of computing after that, at most.
        log: what it prints goes there.
        pause: while this file exists the process is stopped, and goes on where it was.

    Returns:
        What it did; also when it crashed.
    """
    with log.open("wb") as file:
        process = subprocess.Popen(command, stdout=file, stderr=file, start_new_session=True)
    still, told, used = False, False, 0.0
    try:
        while process.poll() is None:
            time.sleep(_LOOK_S)
            used = cpu_seconds_of(process.pid, used)
            if still != (still := pause is not None and pause.exists()):
                os.killpg(process.pid, signal.SIGSTOP if still else signal.SIGCONT)
            start_up = _start_up(log)
            if not told and start_up is not None and used - start_up >= cpu_seconds:
                told = True
                process.send_signal(signal.SIGUSR1)  # libFuzzer ends after the input it is at, and says what it did
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        for left in folder().parent.glob(f"orca-fuzz-{process.pid}-*"):  # libFuzzer ends without a word to Python
            shutil.rmtree(left, ignore_errors=True)
    done = re.findall(r"^#(\d+)|stat::number_of_executed_units: (\d+)", log.read_text(errors="replace"), re.MULTILINE)
    start_up = _start_up(log)
    computed = 0.0 if start_up is None else max(0.0, used - start_up)
    return Ended(max((int(a or b) for a, b in done), default=0), computed, process.returncode != 0)


def cpu_seconds_of(pid: int, known: float = 0.0) -> float:
    """User and system time of a process and of the children it waited for; ``known`` once it is gone."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return known
    return max(known, sum(int(ticks) for ticks in fields[11:15]) / _TICKS)


def artifact_repeats(target: str, artifact: Path) -> bool:
    """Whether an input that was called a time-out fails again by itself, within a minute of computing.

    libFuzzer's limit is by the clock: a machine that was paused is none that hangs.
    """
    code = (
        f"import resource,runpy,sys; resource.setrlimit(resource.RLIMIT_CPU, ({_ALONE_S}, {_ALONE_S})); "
        "sys.argv = ['engine', *sys.argv[1:]]; runpy.run_module('tests.fuzz.engine', run_name='__main__')"
    )
    command = [sys.executable, "-c", code, target, str(artifact.parent), str(artifact)]
    return subprocess.run(command, capture_output=True).returncode != 0


def _start_up(log: Path) -> float | None:
    """Seconds of computing before the first input; None while it is not ready."""
    with log.open("rb") as file:
        found = re.search(rb"^ready: ([\d.]+)$", file.read(1 << 16), re.MULTILINE)
    return float(found[1]) if found else None
