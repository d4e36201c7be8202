"""Scenes as tasks of a Ray cluster: one that runs already, or a new one on this machine.

Every machine must see the same files: code, data, and the folder of the run. Which task runs where is Ray's affair; it
is told what a scene needs.
"""

from __future__ import annotations

import socket
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

from bench.executors.executor import Resources
from bench.executors.losses import Losses
from bench.executors.remote import finish_with, not_started, tell
from bench.progress import Reporter
from bench.scenework import SceneOutcome, SceneWork, opened
from orca.errors import BadInput, Unavailable

__all__ = ["RayCluster"]

_WAITING = 1000  # tasks handed over at a time: Ray keeps each of them in memory


@dataclass(frozen=True)
class RayCluster:
    """A Ray cluster.

    Attributes:
        address: "HOST:PORT", "auto" for the one that runs on this machine, or None for a new one on it.
        jobs: scenes at a time; None for as many as the cluster has room for.
        resources: of one scene; cores None: one.
    """

    address: str | None = None
    jobs: int | None = None
    resources: Resources = field(default_factory=Resources)

    def run(self, work: SceneWork, scenes: Sequence[str], reporter: Reporter) -> Iterator[SceneOutcome]:
        """As `Executor.run`.

        Raises:
            Unavailable: Ray is not installed, or there is no cluster at the address.
            BadInput: no machine of the cluster has what a scene needs.
        """
        ray = _ray()
        losses, cells = Losses(work, reporter), len(opened(work).adapters)
        with _connected(ray, self.address), _cancelled(ray) as running:
            self._check_room(ray)
            task, shared = self._task(ray), ray.put(work)
            waiting = deque((scene, False) for scene in scenes)
            while waiting or running:
                while waiting and len(running) < (self.jobs or _WAITING):
                    scene, again = waiting.popleft()
                    running[task.remote(self._cores, shared, scene, again)] = scene
                for done in ray.wait(list(running), num_returns=1, timeout=None)[0]:
                    scene = running.pop(done)
                    outcome = _result(ray, done)
                    if isinstance(outcome, str):
                        losses.again(scene, outcome)
                        waiting.appendleft((scene, True))
                        continue
                    yield from tell(outcome, cells, reporter)

    def _task(self, ray: ModuleType) -> Any:
        """The function as Ray calls it: once, whatever happens, since a loss is ours to count."""
        return ray.remote(
            num_cpus=self._cores,
            num_gpus=self.resources.gpus,
            memory=int(self.resources.memory_gib * 2**30),
            max_retries=0,
        )(finish_with)

    @property
    def _cores(self) -> int:
        return self.resources.cores or 1

    def _check_room(self, ray: ModuleType) -> None:
        """Ray would wait for a machine that fits for ever."""
        needs = {"CPU": self._cores, "GPU": self.resources.gpus, "memory": self.resources.memory_gib * 2**30}
        nodes = [node["Resources"] for node in ray.nodes() if node["Alive"]]
        if not any(all(node.get(name, 0) >= amount for name, amount in needs.items()) for node in nodes):
            found = "; ".join(
                f"{node.get('CPU', 0):g} cores, {node.get('memory', 0) / 2**30:.1f} GiB, {node.get('GPU', 0):g} GPUs"
                for node in nodes
            )
            raise BadInput(
                f"{needs['CPU']} cores, {self.resources.memory_gib:g} GiB and {needs['GPU']:g} GPUs for a scene",
                f"what one machine of the cluster has ({found})",
                "lower --cores-per-scene, --memory-per-scene or --gpus-per-scene, or add a machine",
            )


def _result(ray: ModuleType, done: Any) -> SceneOutcome | Exception | str:
    """What the task returned, or in words why its process is gone."""
    errors = ray.exceptions
    try:
        result: SceneOutcome | Exception = ray.get(done)
    except (errors.WorkerCrashedError, errors.OutOfMemoryError, errors.NodeDiedError, errors.ObjectLostError) as error:
        return " ".join(str(error).split())[:200]
    except errors.RayError as error:
        return not_started(error)
    return result


def _ray() -> ModuleType:
    try:
        import ray
    except ImportError as error:
        raise Unavailable("Ray is not installed", "pip install 'orca-nvs[cluster]'", "install it") from error
    module: ModuleType = ray
    return module


def _reach(address: str | None) -> None:
    """Raise OSError at once where nobody answers; Ray would try for most of a minute."""
    host, colon, port = (address or "").rpartition(":")
    if colon and port.isdecimal() and "/" not in host:
        socket.create_connection((host, int(port)), timeout=10).close()


@contextmanager
def _connected(ray: ModuleType, address: str | None) -> Iterator[None]:
    """A connection, unless the caller has one; ended when it was made here."""
    if ray.is_initialized():
        yield
        return
    try:
        _reach(address)
        ray.init(address, include_dashboard=False if address is None else None, logging_level="ERROR")
    except (OSError, ValueError, RuntimeError) as error:
        raise Unavailable(
            f"no Ray cluster at {address or 'this machine'} ({' '.join(str(error).split())[:200]})",
            "the address of one that runs",
            "start one with ray start --head, or leave --address out",
        ) from error
    try:
        yield
    finally:
        ray.shutdown()


@contextmanager
def _cancelled(ray: ModuleType) -> Iterator[dict[Any, str]]:
    """Tasks that are under way, by their reference; those that still are at the end are ended."""
    running: dict[Any, str] = {}
    try:
        yield running
    finally:
        for reference in running:
            ray.cancel(reference, force=True)
