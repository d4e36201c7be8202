"""The paper's rule for failures: a scene on which any method fails counts for none of them.

The paper drops the one DIV2K scene on which a method fails from both methods and reports 99 of 100. That hides a
failure, so the table by that rule is printed beside the honest one and never instead of it.
"""

from __future__ import annotations

from dataclasses import replace

from bench.measured import Measured

__all__ = ["failed_anywhere", "without_failed_anywhere"]


def failed_anywhere(run: Measured) -> tuple[str, ...]:
    """The scenes on which some method failed, in order.

    A scene that was not run yet, or a metric that failed or has no weights, is no failure of a method.
    """
    return tuple(
        scene
        for scene in run.scenes
        if any((r := run.records.get((method, scene))) is not None and r.failure is not None for method in run.methods)
    )


def without_failed_anywhere(run: Measured) -> Measured:
    """The same run over the scenes on which no method failed; the caption names those left out."""
    gone = failed_anywhere(run)
    kept = tuple(scene for scene in run.scenes if scene not in gone)
    rule = (
        f"By the paper's rule: {len(kept)} of {len(run.scenes)} scenes; left out for every method, because one failed "
        f"on it: {', '.join(gone) or 'none'}."
    )
    return replace(run, scenes=kept, caption=(*run.caption, rule))
