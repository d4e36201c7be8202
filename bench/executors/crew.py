"""The processes of `bench.executors.local`: started when there is memory for them, heard, replaced and ended."""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import connection as connections
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Any

from bench.executors.executor import Resources
from bench.executors.memory import available_gib
from bench.executors.worker import serve
from bench.processes import memory_mb
from bench.scenework import SceneWork
from orca.errors import Unavailable

__all__ = ["Crew", "Message", "fits", "gpus_of", "visible_gpus"]

Message = tuple[str, Any]

_THREADS = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_GONE = (BrokenPipeError, ConnectionResetError)  # what the end of a line is that nobody holds any more
_GPUS = "CUDA_VISIBLE_DEVICES"
_LOOK_AGAIN_S = 1.0  # how often memory is looked at while a scene waits for it
_LEAVE_S = 10.0  # how long a worker that is asked to end may take to drop its unfinished file


@dataclass(eq=False)
class _Worker:
    number: int
    process: SpawnProcess
    line: Connection
    scene: str | None = None
    ready: bool = False

    @property
    def resident(self) -> float:
        return (memory_mb(process=self.process.pid) or 0.0) * 1e6 / 2**30


class Crew:
    """Workers that take a scene at a time.

    Args:
        work: what they do.
        size: how many there are at most.
        threads: of each.
        resources: of one scene.
    """

    def __init__(self, work: SceneWork, size: int, threads: int, resources: Resources) -> None:
        self._work, self._size, self._threads, self._resources = work, size, threads, resources
        self._workers: list[_Worker] = []
        self._gpus = visible_gpus() if resources.gpus else ()

    @property
    def busy(self) -> bool:
        """Whether anybody works."""
        return any(worker.scene is not None for worker in self._workers)

    def take(self, scene: str, again: bool) -> bool:
        """Hand a scene to a free worker, a new one if need be; False if all work, or memory must become free first.

        With nobody at work a scene is always taken, whatever it may need.
        """
        free = next((worker for worker in self._workers if worker.scene is None), None)
        if free is None and len(self._workers) >= self._size:
            return False
        working = [worker.resident for worker in self._workers if worker.scene is not None]
        held = 0.0 if free is None else free.resident
        if not fits(self._resources.memory_gib, held, working, available_gib() if working else None):
            return False
        worker = free or self._start()
        worker.scene = scene
        with suppress(*_GONE):  # it died while it was free: `heard` finds that out
            worker.line.send((scene, again))
        return True

    def heard(self) -> Iterator[Message]:
        """What the workers said, waiting for it for a while: (kind, content) as `bench.executors.worker.serve` says.

        A worker that is gone gives ("lost", (scene, why)); one that did not even start, ("error", Unavailable).
        """
        lines = {worker.line: worker for worker in self._workers}
        for line in connections.wait(list(lines), timeout=_LOOK_AGAIN_S):
            worker = lines[line]  # type: ignore[index]
            try:
                message: Message = worker.line.recv()
            except (EOFError, *_GONE):
                yield from self._lost(worker)
                continue
            if message[0] == "ready":
                worker.ready = True
                continue
            if message[0] == "done":
                worker.scene = None
            yield message

    def dismiss(self) -> None:
        """End workers that have nothing to do."""
        for worker in self._workers:
            with suppress(*_GONE):
                worker.line.send(None)
        self._leave()

    def stop(self) -> None:
        """End workers whatever they do; files that they have not finished are dropped."""
        for worker in self._workers:
            worker.process.terminate()
        self._leave()

    def _leave(self) -> None:
        try:
            for worker in self._workers:
                worker.process.join(_LEAVE_S)
        finally:  # also on a second Ctrl-C
            for worker in self._workers:
                worker.process.kill()
                worker.process.join()
                worker.line.close()
            self._workers.clear()

    def _lost(self, worker: _Worker) -> Iterator[Message]:
        self._workers.remove(worker)
        worker.line.close()
        worker.process.join()
        ending = _ending(worker.process.exitcode)
        if not worker.ready and (worker.process.exitcode or 0) > 0:
            given = f"a worker did not start: {ending}"
            yield "error", Unavailable(given, "a process that imports this code", "see what it wrote to stderr")
        elif worker.scene is not None:
            yield "lost", (worker.scene, ending)

    def _start(self) -> _Worker:
        number = next(n for n in range(self._size) if all(n != worker.number for worker in self._workers))
        ours, theirs = multiprocessing.Pipe()
        level = logging.getLogger("bench").getEffectiveLevel()
        process = multiprocessing.get_context("spawn").Process(
            target=serve, args=(theirs, self._work, self._threads, level), name=f"bench worker {number}"
        )
        with _environment(self._settings(number)), _ctrl_c_waits():
            process.start()
        theirs.close()
        self._workers.append(_Worker(number, process, ours))
        return self._workers[-1]

    def _settings(self, number: int) -> dict[str, str]:
        threads = dict.fromkeys(_THREADS, str(self._threads))
        gpus = gpus_of(number, self._resources.gpus, self._gpus)
        return threads | ({_GPUS: ",".join(gpus)} if gpus else {})


def fits(needed: float, held: float, working: Sequence[float], available: float | None) -> bool:
    """Whether another scene may start, all in GiB.

    Args:
        needed: what a scene may need at its peak.
        held: what the worker that would take it holds already.
        working: what each worker holds that works on one; the rest of its need is not there to be given away.
        available: memory that could be taken; None where nobody knows.
    """
    if not working or available is None:
        return True
    promised = sum(max(0.0, needed - resident) for resident in working)
    return available - promised >= max(0.0, needed - held)


def visible_gpus() -> tuple[str, ...]:
    """The names of the GPUs that this process may use, as CUDA_VISIBLE_DEVICES has them."""
    if (listed := os.environ.get(_GPUS)) is not None:
        return tuple(name.strip() for name in listed.split(",") if name.strip())
    import torch

    return tuple(str(i) for i in range(torch.cuda.device_count()))


def gpus_of(number: int, each: float, gpus: Sequence[str]) -> tuple[str, ...]:
    """The GPUs of one worker: ``each`` of its own, or, below one, shared with its neighbours; none for ``each`` 0."""
    if not each:
        return ()
    first = int(number * each)
    return tuple(gpus[first : max(first + 1, int((number + 1) * each))])


def _ending(exitcode: int | None) -> str:
    if exitcode is not None and exitcode < 0:
        out = ", as the system does when memory runs out" if exitcode == -signal.SIGKILL else ""
        return f"killed by {signal.Signals(-exitcode).name}{out}"
    return f"it ended with exit code {exitcode}"


@contextmanager
def _environment(settings: dict[str, str]) -> Iterator[None]:
    """Variables that a child must have before it imports anything."""
    before = {name: os.environ.get(name) for name in settings}
    os.environ.update(settings)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def _ctrl_c_waits() -> Iterator[None]:
    """Hold SIGINT back: a child that is started here never gets it, this process gets it afterwards."""
    resource_tracker.ensure_running()  # started by the first child, it would let the signal through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
