"""What the executors of clusters share: tasks that are waited for by asking, with no line to the one who waits."""

from __future__ import annotations

from collections.abc import Iterator

from bench.progress import Reporter
from bench.scenework import SceneOutcome

__all__ = ["tell"]


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
