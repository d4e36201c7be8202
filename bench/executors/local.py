"""Several processes of this machine, a scene each at a time, as many as its memory bears.

A process lives for many scenes: weights that a metric has loaded, and compiled code, are kept. Its death costs the step
it was at and nothing else (`bench.executors.losses`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from bench.executors.crew import Crew, Message, visible_gpus
from bench.executors.executor import Resources
from bench.executors.losses import Losses
from bench.executors.memory import available_gib
from bench.host import usable_cores
from bench.progress import Reporter
from bench.scenework import SceneOutcome, SceneWork
from orca.errors import BadInput

__all__ = ["LocalWorkers", "share"]


@dataclass(frozen=True)
class LocalWorkers:
    """N workers on this machine.

    Attributes:
        jobs: how many at most.
        resources: of one scene; cores None: this machine's, divided by the workers.
    """

    jobs: int
    resources: Resources = field(default_factory=Resources)

    def __post_init__(self) -> None:
        if self.jobs < 1:
            raise BadInput(f"--jobs {self.jobs}", "1 or more", "give 1 for one scene after another")

    def run(self, work: SceneWork, scenes: Sequence[str], reporter: Reporter) -> Iterator[SceneOutcome]:
        """As `Executor.run`; says when memory allows fewer workers than were asked for."""
        if not scenes:
            return
        gpus = len(visible_gpus()) if self.resources.gpus else 0
        room = (usable_cores(), available_gib(), self.resources, gpus)
        workers, threads, reduced = share(self.jobs, len(scenes), *room)
        if reduced:
            reporter.note(reduced)
        losses = Losses(work, reporter)
        waiting = deque((scene, False) for scene in scenes)
        crew = Crew(work, workers, threads, self.resources)
        try:
            while waiting or crew.busy:
                while waiting and crew.take(*waiting[0]):
                    waiting.popleft()
                for message in crew.heard():
                    if message[0] == "lost":
                        losses.again(*message[1])
                        waiting.appendleft((message[1][0], True))
                    elif (outcome := _told(message, reporter)) is not None:
                        yield outcome
        except BaseException:
            crew.stop()
            raise
        crew.dismiss()


def _told(message: Message, reporter: Reporter) -> SceneOutcome | None:
    """Pass a worker's word on; the outcome, if it is one. Raises what the worker raised."""
    kind, what = message
    if kind == "error":
        raise what
    if kind == "phase":
        reporter.phase(*what)
    elif kind == "cell":
        reporter.cell(what)
    elif isinstance(what, SceneOutcome):
        reporter.scene_over(what.scene)
        return what
    return None


def share(
    jobs: int, scenes: int, cores: int, available: float | None, resources: Resources, gpus: int = 0
) -> tuple[int, int, str]:
    """How many workers, how many threads each, and in words what was reduced and why.

    Args:
        jobs: workers asked for.
        scenes: how many there are to do.
        cores: of this machine.
        available: memory, GiB; None where nobody knows, and then it is no limit.
        resources: of one scene.
        gpus: of this machine; no limit where a scene needs none.
    """
    workers, said = min(jobs, scenes), []
    room = workers if available is None else int(available / resources.memory_gib)
    if room < workers:
        said.append(f"{available:.1f} GiB are available and a scene is given {resources.memory_gib:g}")
    if resources.gpus and int(gpus / resources.gpus) < workers:
        room = min(room, int(gpus / resources.gpus))
        said.append(f"there are {gpus} GPUs and a scene is given {resources.gpus:g}")
    reduced = max(1, min(workers, room))
    words = f"{reduced} of {workers} workers: {'; '.join(said)}" if said else ""
    return reduced, resources.cores or max(1, cores // reduced), words
