"""A child process that does jobs one at a time, under limits, and is replaced when one kills it."""

from __future__ import annotations

import faulthandler
import multiprocessing
import os
import signal
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Self

from bench.processes import end_with_parent, memory_mb
from bench.stability.job import Done, Job
from bench.stability.outcome import CRASH, OUT_OF_MEMORY, TIME_OUT, Verdict

__all__ = ["WAITING", "Limits", "Report", "Worker"]

WAITING = 10.0

_TICK_S = 0.05
_LONGEST_TICK_S = 1.0  # a longer pause means that this process was stopped, and the child with it
_LAST_WORDS = 400


@dataclass(frozen=True)
class Limits:
    """What a job may take.

    Attributes:
        seconds: of CPU time, all threads together, so that a busy machine fails nobody; by the clock `WAITING` times
            that, for a process that waits for what never comes.
        memory_mb: of resident memory, MB (10^6 bytes).
    """

    seconds: float = 300.0
    memory_mb: float = 8000.0


@dataclass(frozen=True)
class Report:
    """How a job came out.

    Attributes:
        verdict: its own, or that it died, took too long or too much memory.
        seconds: what the method took by the clock; for a job that was ended, how long it had run.
        cpu_s: CPU time of the whole job, making its input included; 0 where the system does not say.
        peak_mb: largest resident memory seen while it ran; None where the system does not say.
    """

    verdict: Verdict
    seconds: float
    cpu_s: float
    peak_mb: float | None


class Worker:
    """Runs jobs in a child process.

    The child stays alive between jobs, which saves seconds of imports. A job on which it dies after it has done others
    is done again in a fresh child, so that nobody is blamed for what an earlier job left behind.

    Args:
        limits: of each job.
    """

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self._process: multiprocessing.process.BaseProcess | None = None
        self._pipe: Connection | None = None
        self._served: list[str] = []
        self._died = False
        # What a job leaves behind when it is killed lies in here too.
        self._scratch = tempfile.TemporaryDirectory(prefix="stability-", ignore_cleanup_errors=True)
        self._log = Path(self._scratch.name) / "printed.log"
        self._log.touch()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._end()
        self._scratch.cleanup()

    def run(self, job: Job) -> Report:
        """Do a job, within the limits."""
        earlier = tuple(self._served)
        report = self._attempt(job)
        if not earlier or not self._died:
            return report
        alone = self._attempt(job)
        note = f"a process that had done {', '.join(earlier[-3:])} before died on it ({report.verdict.detail})"
        detail = "; ".join(part for part in (alone.verdict.detail, note) if part)
        return replace(alone, verdict=replace(alone.verdict, detail=detail))

    def _attempt(self, job: Job) -> Report:
        pipe = self._started()
        process, self._died = self._process, False
        if process is None:
            raise RuntimeError("the worker has no process")
        mark = self._log.stat().st_size
        pipe.send(job)
        spent, peak, before = 0.0, memory_mb(process=process.pid), time.monotonic()
        worked = _cpu_seconds(process.pid)
        while not pipe.poll(_TICK_S):
            now = time.monotonic()
            spent, before = spent + min(now - before, _LONGEST_TICK_S), now
            used = memory_mb(process=process.pid)
            peak = None if used is None and peak is None else max(used or 0.0, peak or 0.0)
            over = self._over(_cpu_seconds(process.pid) - worked, spent, used)
            if over is not None:
                cpu = _cpu_seconds(process.pid) - worked
                self._end()
                return Report(over, spent, cpu, peak)
        try:
            done: Done = pipe.recv()
        except (EOFError, ConnectionError):
            return Report(self._death(mark), spent, 0.0, peak)
        cpu = _cpu_seconds(process.pid) - worked
        self._served.append(job.name)
        if job.leaves_traces:
            self._end()
        return Report(done.verdict, done.seconds, cpu, peak)

    def _over(self, worked: float, spent: float, used: float | None) -> Verdict | None:
        """The verdict on a job that goes beyond a limit."""
        if worked > self.limits.seconds:
            return Verdict(TIME_OUT, f"not done after {self.limits.seconds:g} s of CPU time")
        if spent > WAITING * self.limits.seconds:
            return Verdict(TIME_OUT, f"not done after {spent:.0f} s by the clock ({worked:.0f} s of CPU time)")
        if used is not None and used > self.limits.memory_mb:
            return Verdict(OUT_OF_MEMORY, f"{used:.0f} MB resident; the limit is {self.limits.memory_mb:.0f} MB")
        return None

    def _death(self, mark: int) -> Verdict:
        """What is known of a child that died: how, and its last words."""
        process = self._process
        if process is not None:
            process.join(10)
        code = None if process is None else process.exitcode
        how = f"killed by {signal.Signals(-code).name}" if code is not None and code < 0 else f"exit code {code}"
        with self._log.open("rb") as log:
            log.seek(mark)
            words = " ".join(log.read().decode(errors="replace").split())
        self._end()
        self._died = True
        return Verdict(CRASH, f"the process died ({how}) {words[:_LAST_WORDS]}".strip())

    def _started(self) -> Connection:
        if self._pipe is None:
            context = multiprocessing.get_context("spawn")
            self._pipe, theirs = context.Pipe()
            self._process = context.Process(target=_serve, args=(theirs, self._log), daemon=True)
            self._process.start()
            theirs.close()  # so that a dead child is the end of the pipe
            self._pipe.recv()  # its imports are no part of the first job
        return self._pipe

    def _end(self) -> None:
        """Stop the child, whatever it does; the next job gets a fresh one."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
        if self._pipe is not None:
            self._pipe.close()
        self._process = self._pipe = None
        self._served = []


def _serve(pipe: Connection, log: Path) -> None:
    """The child: jobs in, results out, until the pipe ends. What is printed, by C code too, goes to the log."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's affair
    tempfile.tempdir = str(log.parent)
    with log.open("ab") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    faulthandler.enable(sys.__stderr__ or 2)
    end_with_parent()
    pipe.send("ready")
    while True:
        try:
            job: Job = pipe.recv()
        except EOFError:
            return
        pipe.send(job.run())


def _cpu_seconds(pid: int | None) -> float:
    """CPU time of a process, all threads; 0 where the system does not say."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    except (OSError, IndexError, ValueError):
        return 0.0
