"""Jobs for the worker of `bench stability`: they end it in every way there is."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path

from bench.stability.job import Done
from bench.stability.outcome import EXACT, Verdict

__all__ = ["DyingJob", "GreedyJob", "OnceJob", "SleepingJob", "SpinningJob", "WellJob"]


@dataclass(frozen=True)
class WellJob:
    """Answers with its process."""

    name: str = "well"
    leaves_traces: bool = False

    def run(self) -> Done:
        return Done(Verdict(EXACT, str(os.getpid())), 0.0)


@dataclass(frozen=True)
class DyingJob:
    """Kills its process, as a fault in compiled code does."""

    name: str = "dying"
    leaves_traces: bool = False

    def run(self) -> Done:
        os.write(2, b"last words\n")
        os.kill(os.getpid(), signal.SIGSEGV)
        time.sleep(60)
        return Done(Verdict(EXACT), 0.0)


@dataclass(frozen=True)
class OnceJob:
    """Kills its process the first time only, as what an earlier job left behind would."""

    mark: Path
    name: str = "once"
    leaves_traces: bool = False

    def run(self) -> Done:
        if not self.mark.exists():
            self.mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return Done(Verdict(EXACT), 0.0)


@dataclass(frozen=True)
class SleepingJob:
    """Waits for what never comes."""

    name: str = "sleeping"
    leaves_traces: bool = False

    def run(self) -> Done:
        time.sleep(600)
        return Done(Verdict(EXACT), 0.0)


@dataclass(frozen=True)
class SpinningJob:
    """Works for ever."""

    name: str = "spinning"
    leaves_traces: bool = False

    def run(self) -> Done:
        while True:
            pass


@dataclass(frozen=True)
class GreedyJob:
    """Takes memory until it is stopped."""

    name: str = "greedy"
    leaves_traces: bool = False

    def run(self) -> Done:
        taken = []
        while len(taken) < 400:
            taken.append(bytearray(os.urandom(1) * 10**7))
            time.sleep(0.01)
        return Done(Verdict(EXACT), 0.0)
