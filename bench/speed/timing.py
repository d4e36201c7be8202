"""Timing in turns: what is compared runs alternately in one process, so that a slow minute slows both."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

__all__ = ["Patience", "Sample", "Timing", "alternate", "paired_ratio", "stopwatch"]

K = TypeVar("K", bound=Hashable)


@dataclass(frozen=True)
class Sample:
    """Seconds of one execution: on the clock, and of all threads of the process together."""

    wall_s: float
    cpu_s: float


@dataclass(frozen=True)
class Patience:
    """How often to repeat.

    Attributes:
        warmup: rounds that are thrown away (compilation, caches).
        repeats: rounds at most.
        least: rounds at least, however long they take.
        seconds: after so many seconds of rounds that count no new one begins.
    """

    warmup: int
    repeats: int
    least: int
    seconds: float


@dataclass(frozen=True)
class Timing:
    """Medians and quartiles over the rounds, in milliseconds."""

    wall_ms: float
    wall_ms_q25: float
    wall_ms_q75: float
    cpu_ms: float
    repeats: int

    @staticmethod
    def of(samples: list[Sample]) -> Timing:
        """Summarise samples; there must be one at least."""
        wall = 1e3 * np.array([s.wall_s for s in samples])
        cpu = 1e3 * np.array([s.cpu_s for s in samples])
        q25, median, q75 = (float(q) for q in np.quantile(wall, [0.25, 0.5, 0.75]))
        return Timing(median, q25, q75, float(np.median(cpu)), len(samples))


def stopwatch(work: Callable[[], object]) -> Sample:
    """Do some work and time it."""
    wall, cpu = time.perf_counter(), time.process_time()
    work()
    return Sample(time.perf_counter() - wall, time.process_time() - cpu)


def alternate(
    works: Mapping[K, Callable[[int], Sample]], patience: Patience, clock: Callable[[], float] = time.perf_counter
) -> dict[K, list[Sample]]:
    """Run every work once a round, in turns, and return its samples.

    A work gets the number of the round, warm-up included, so that no round repeats what another has cached and all
    works of a round do the same. Every second round goes backwards: neither work always follows the other.
    """
    samples: dict[K, list[Sample]] = {key: [] for key in works}
    started = clock()
    for number in range(patience.warmup + patience.repeats):
        counted = number - patience.warmup
        if counted == 0:
            started = clock()
        if counted >= patience.least and clock() - started > patience.seconds:
            break
        keys = list(works) if number % 2 == 0 else list(works)[::-1]
        for key in keys:
            sample = works[key](number)
            if counted >= 0:
                samples[key].append(sample)
    return samples


def paired_ratio(slow: list[Sample], fast: list[Sample]) -> tuple[float, float, float, float]:
    """How many times faster, round by round: median, lowest and highest wall ratio, and the median CPU ratio."""
    wall = [a.wall_s / b.wall_s for a, b in zip(slow, fast, strict=True)]
    cpu = [a.cpu_s / max(b.cpu_s, 1e-9) for a, b in zip(slow, fast, strict=True)]
    return float(np.median(wall)), min(wall), max(wall), float(np.median(cpu))
