"""What the executors of clusters share: tasks that are waited for by asking, with no line to the one who waits."""

from __future__ import annotations

import os
from collections.abc import Iterator

from bench.progress import Reporter
from bench.scenework import SceneOutcome, SceneWork, finish_scene
from orca.errors import Unavailable

__all__ = ["finish_with", "not_started", "tell"]


def finish_with(cores: int, work: SceneWork, scene: str, again: bool) -> SceneOutcome | Exception:
    """The task, in its process: `bench.scenework.finish_scene` with as many threads as it was given cores.

    numba and torch are told before they are imported; BLAS, loaded by then, keeps to the cores that the system allows.
    """
    for name in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ[name] = str(cores)
    import cv2

    cv2.setNumThreads(cores)
    return finish_scene(work, scene, again)


def not_started(error: Exception) -> Unavailable:
    """What it means that a task raised, since the scene's own errors come back as values."""
    return Unavailable(
        f"a task could not be done: {' '.join(str(error).split())[-400:]}",
        "machines with this code, its packages, the data and the folder of the run",
        "see that the same command works on such a machine",
    )


def tell(outcome: SceneOutcome | Exception, cells: int, reporter: Reporter) -> Iterator[SceneOutcome]:
    """Say how a scene's cells went and yield the outcome.

    Args:
        outcome: what the task returned.
        cells: how many the scene has.
        reporter: told of each.

    Raises:
        Exception: the one that the task returned.
    """
    if isinstance(outcome, Exception):
        raise outcome
    for line in (*outcome.lines, *[None] * (cells - len(outcome.lines))):
        reporter.cell(line)
    reporter.scene_over(outcome.scene)
    yield outcome
