"""What an executor is, and the one that needs nothing: this process."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

from bench.progress import Reporter
from bench.scenework import SceneOutcome, SceneWork, opened
from orca.errors import BadInput

__all__ = ["DEFAULT_MEMORY_GIB", "Executor", "InThisProcess", "Resources"]

# A process that runs the preset draft on a 512x512 scene peaks at 1.3 to 1.5 GB, as `bench.memory` measures it.
DEFAULT_MEMORY_GIB = 2.0


@dataclass(frozen=True)
class Resources:
    """What one scene is given.

    Attributes:
        cores: processor cores, and threads; None for what the executor finds fair.
        memory_gib: memory it may need at its peak, GiB.
        gpus: graphics processors; a fraction shares one.

    Raises:
        BadInput: a number that makes no sense.
    """

    cores: int | None = None
    memory_gib: float = DEFAULT_MEMORY_GIB
    gpus: float = 0.0

    def __post_init__(self) -> None:
        if self.cores is not None and self.cores < 1:
            raise BadInput(f"{self.cores} cores for a scene", "1 or more", "leave it out, or give 1")
        if not 0 < self.memory_gib < float("inf"):
            raise BadInput(f"{self.memory_gib:g} GiB for a scene", "more than 0", "give what one scene needs")
        if not 0 <= self.gpus < float("inf"):
            raise BadInput(f"{self.gpus:g} GPUs for a scene", "0 or more", "give 0, 1, or a fraction")


class Executor(Protocol):
    """Finishes scenes, in any order, wherever it likes."""

    def run(self, work: SceneWork, scenes: Sequence[str], reporter: Reporter) -> Iterator[SceneOutcome]:
        """Yield how each scene went, as soon as it is known.

        A process that is lost is no error: its scene is tried once more, and then the step it was lost at is recorded
        as failed (`bench.executors.losses`). Leaving the iterator early, or an error, ends what was started.

        Raises:
            OrcaError: what a task raised that no scene is to blame for: another run's files, a full disk.
        """
        ...


class InThisProcess:
    """One scene after another, here."""

    def run(self, work: SceneWork, scenes: Sequence[str], reporter: Reporter) -> Iterator[SceneOutcome]:
        """As `Executor.run`; a process that is lost is this one."""
        runner = opened(work)
        for scene in scenes:
            yield runner.finish(scene, reporter)
