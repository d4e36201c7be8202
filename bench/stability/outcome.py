"""What can become of a method on a case, and how a finished output is judged."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.adapters.adapter import MethodOutput
from bench.checks import BadOutput, check_output
from bench.datasets.case import SceneCase
from bench.metrics.coverage import COVERED
from bench.metrics.fidelity import mean_squared_error, psnr_of_mse
from bench.warping import forward_splat
from orca.errors import OrcaError

__all__ = [
    "CONTAINED",
    "CRASH",
    "DEGRADED",
    "EXACT",
    "FALLBACK",
    "FAITHFUL_DB",
    "FINISHED",
    "HOLES_ALLOWED",
    "HONEST",
    "OUTCOMES",
    "OUT_OF_MEMORY",
    "SILENT_WRONG",
    "TIME_OUT",
    "TYPED",
    "Verdict",
    "failed",
    "judge",
]

EXACT = "exact"
DEGRADED = "degraded"
TYPED = "typed failure"
CRASH = "crash"
TIME_OUT = "time-out"
OUT_OF_MEMORY = "out of memory"
SILENT_WRONG = "silent wrong"

OUTCOMES = (EXACT, DEGRADED, TYPED, CRASH, TIME_OUT, OUT_OF_MEMORY, SILENT_WRONG)
FINISHED = (EXACT, DEGRADED)
HONEST = (EXACT, DEGRADED, TYPED)
CONTAINED = (*HONEST, OUT_OF_MEMORY)

FALLBACK = "fallback: "  # how a note begins that says what was done instead of what was asked for
HOLES_ALLOWED = 0.01  # share of the pixels of all views
INVENTED_ALLOWED = 0.5  # share of the pixels of all frames; most paths look a little beyond the input
FAITHFUL_DB = 25.0  # PSNR of the input view from which on nothing of the input counts as lost
_CRACK = 9  # pixels: gaps between the points of a magnified surface are no holes


@dataclass(frozen=True)
class Verdict:
    """An outcome and why.

    Attributes:
        outcome: one of `OUTCOMES`.
        detail: what was lost, or what failed, in words; empty for an exact result.
        numbers: "holes" (share of all views), "input_psnr" (dB), where they are known.
    """

    outcome: str
    detail: str = ""
    numbers: dict[str, float] = field(default_factory=dict)


def judge(case: SceneCase, output: MethodOutput, complaint: str | None = None) -> Verdict:
    """Say what a finished output is worth.

    Silent wrong: another number or shape of views than asked for, NaN in coverage or in covered depth, a view that
    counts as covered with no point in it, more than 1 % holes that no note mentions, or a ``complaint`` of the case's
    own check. Degraded: more than 1 % holes that a note mentions, or pixels painted in without geometry, or an input
    view under 25 dB, or a fallback, or frames that mostly show geometry where the input had none. Else exact.

    Args:
        case: what was asked for.
        output: what came back.
        complaint: what the case's own check has against it.
    """
    try:
        check_output(case, output)
    except BadOutput as error:
        return Verdict(SILENT_WRONG, error.given)
    holes = _holes(output)
    numbers = {} if holes is None else {"holes": holes}
    psnr = _input_psnr(case, output)
    if psnr is not None:
        numbers["input_psnr"] = psnr
    complaint = _broken_depth(output) or _empty_views(output) or complaint
    if complaint:
        return Verdict(SILENT_WRONG, complaint, numbers)
    lost = [note.removeprefix(FALLBACK) for note in output.notes if note.startswith(FALLBACK)]
    if holes is not None and holes > HOLES_ALLOWED:
        if not any("hole" in note.lower() for note in output.notes):
            return Verdict(SILENT_WRONG, f"{holes:.1%} holes, and no word about them", numbers)
        lost.append(f"{holes:.1%} holes, and says so")
    painted = _painted(output)
    if painted > HOLES_ALLOWED:
        lost.append(f"{painted:.1%} painted in, without geometry")
    invented = _invented(case, output)
    if invented > INVENTED_ALLOWED:
        lost.append(f"{invented:.0%} of the frames is invented: the input never showed it")
    if psnr is not None and psnr < FAITHFUL_DB:
        lost.append(f"input view {psnr:.1f} dB")
    return Verdict(DEGRADED if lost else EXACT, "; ".join(lost), numbers)


def failed(error: BaseException, phase: str) -> Verdict:
    """The outcome of an exception: typed, out of memory, or a crash."""
    said = error.given if isinstance(error, OrcaError) else f"{type(error).__name__}: {error}"
    text = f"{' '.join(said.split())[:400]}" + ("" if phase == "method" else f" (in {phase})")
    if isinstance(error, OrcaError):
        return Verdict(TYPED, text)
    return Verdict(OUT_OF_MEMORY if _is_memory(error) else CRASH, text)


def _is_memory(error: BaseException) -> bool:
    """torch and OpenCV have their own words for what is a MemoryError elsewhere."""
    words = ("can't allocate memory", "not enough memory", "insufficient memory", "out of memory", "cannot allocate")
    return isinstance(error, MemoryError) or any(word in str(error).lower() for word in words)


def _holes(output: MethodOutput) -> float | None:
    """Share of pixels with coverage under one half, over the frames and the true views."""
    if output.coverage is None:
        return None
    every = [output.coverage.ravel(), *(alpha.ravel() for alpha in output.true_view_coverage or ())]
    return float(np.mean(~(np.concatenate(every) >= COVERED)))


def _input_psnr(case: SceneCase, output: MethodOutput) -> float | None:
    """PSNR of the input view, None where it has another size or there is none; 99 dB for equal images."""
    if output.input_view is None or output.input_view.shape != case.image.shape:
        return None
    return min(99.0, psnr_of_mse(mean_squared_error(output.input_view, case.image)))


def _without_depth(output: MethodOutput) -> NDArray[np.bool_] | None:
    """Pixels of the frames that count as covered and have no depth, [n, H, W]; None where depth is not given."""
    if output.frame_depth is None or output.coverage is None:
        return None
    depth = output.frame_depth
    return np.asarray((output.coverage >= COVERED) & ~(np.isfinite(depth) & (depth > 0)))


def _painted(output: MethodOutput) -> float:
    """Share of all pixels that are covered and have no depth."""
    without = _without_depth(output)
    return 0.0 if without is None else float(without.mean())


def _invented(case: SceneCase, output: MethodOutput) -> float:
    """Share of all pixels that are covered, with a depth, where no pixel of the input lands (small cracks closed)."""
    if output.coverage is None or output.frame_depth is None:
        return 0.0
    kernel = np.ones((_CRACK, _CRACK), np.uint8)
    shares = []
    for camera, alpha, depth in zip(case.eval_trajectory.cameras(), output.coverage, output.frame_depth, strict=True):
        hit = forward_splat(case.image, case.depth, case.camera, camera).hit.astype(np.uint8)
        seen = cv2.morphologyEx(hit, cv2.MORPH_CLOSE, kernel) > 0
        there = (alpha >= COVERED) & np.isfinite(depth) & (depth > 0)
        if there.shape != seen.shape:  # frames of another size than the cameras': other checks' affair
            return 0.0
        shares.append(float(np.mean(there & ~seen)))
    return float(np.mean(shares))


def _empty_views(output: MethodOutput) -> str | None:
    """Views that count as covered although there is not one point in them."""
    without = _without_depth(output)
    empty = 0 if without is None else int(without.reshape(len(without), -1).all(1).sum())
    return f"{empty} of {len(output.frames)} views count as covered, and no point is in them" if empty else None


def _broken_depth(output: MethodOutput) -> str | None:
    """Pixels that count as covered and have NaN for a depth."""
    if output.frame_depth is None or output.coverage is None:
        return None
    broken = float(np.mean(np.isnan(output.frame_depth) & (output.coverage >= COVERED)))
    return f"NaN depth at {broken:.1%} of the covered pixels" if broken > 0 else None
