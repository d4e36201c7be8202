"""What becomes of a scene whose process is gone: once more, and then without the step that it was lost at."""

from __future__ import annotations

from bench.progress import Reporter
from bench.scenework import CellLeft, LostWorker, SceneWork, opened

__all__ = ["Losses"]


class Losses:
    """Keeps account of lost processes over a run.

    Args:
        work: what is being done.
        reporter: told of every loss.
    """

    def __init__(self, work: SceneWork, reporter: Reporter) -> None:
        self._runner = opened(work)
        self._reporter = reporter
        self._once: set[CellLeft] = set()

    def again(self, scene: str, why: str) -> None:
        """Decide after a loss; the scene is to be handed out again.

        The step that the files do not have yet is the one it was lost at. Lost there a second time, the step is
        recorded as failed (kind "lost_worker"); the scene goes on with the next.

        Args:
            scene: whose process is gone.
            why: in words, as far as anybody knows.
        """
        self._reporter.scene_over(scene)
        step = self._runner.next_step(scene)
        if step is None:  # it had just finished
            return
        at = f"{step.scene}, {step.method}" + (f", {step.family}" if step.family else "")
        if step not in self._once:
            self._once.add(step)
            self._reporter.note(f"worker lost at {at} ({why}): the scene is tried once more")
            return
        error = LostWorker(
            f"the worker was lost twice at {at}: {why}",
            "a process that lives until the end of the step",
            "see the memory a scene needs (--memory-per-scene, --jobs); then rerun with --retry-failed",
        )
        self._runner.give_up(step, error)
        self._reporter.note(f"worker lost twice at {at} ({why}): recorded as failed, the rest of the scene goes on")
