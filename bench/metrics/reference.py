"""Scores against a photograph: the true second view where a data set has one, and the input itself."""

from __future__ import annotations

import math
from importlib.metadata import version
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from bench.datasets.case import SceneCase, TrueView
from bench.metrics.fidelity import (
    PSNR_VARIANT,
    RESIZE_RULE,
    SSIM_VARIANT,
    SSIM_WINDOW,
    mean_squared_error,
    psnr_of_mse,
    resize_to,
    ssim,
    ssim_inside,
)
from bench.metrics.metric import MetricInput, MetricSpec, Score
from orca.conventions import UInt8Array
from orca.errors import BadInput

__all__ = ["NOTHING_HIDDEN", "InputPsnr", "TrueViewScores", "matched_renders", "mean_over_views", "no_true_view"]

NOTHING_HIDDEN = "nothing is hidden in the true view"
IDENTICAL = "identical to the reference (infinite PSNR)"
SHIFTS = (-1.0, -0.5, 0.0, 0.5, 1.0)
BORDER = 2


class TrueViewScores:
    """PSNR and SSIM against real photographs from other places, over the image and on what the input could not see."""

    def specs(self, weights_dir: Path | None) -> tuple[MetricSpec, ...]:
        """Specs of `psnr`, `ssim`, `hole_psnr` and `hole_ssim`."""
        views = f"mean over true views; {RESIZE_RULE}"
        hidden = "PSNR inside the mask of pixels that no input pixel reaches; mean over true views"
        hidden_map = "SSIM map averaged inside the mask of pixels that no input pixel reaches; mean over true views"
        return (
            MetricSpec("psnr", "PSNR, true view (dB)", True, (0.0, None), f"{PSNR_VARIANT}; {views}", "bench 1", 2),
            MetricSpec(
                "ssim",
                "SSIM, true view",
                True,
                (-1.0, 1.0),
                f"{SSIM_VARIANT}; {views}",
                f"scikit-image {version('scikit-image')}",
            ),
            MetricSpec(
                "hole_psnr",
                "PSNR, hidden part (dB)",
                True,
                (0.0, None),
                f"{PSNR_VARIANT}; {hidden}; {RESIZE_RULE}",
                "bench 1",
                2,
            ),
            MetricSpec(
                "hole_ssim",
                "SSIM, hidden part",
                True,
                (-1.0, 1.0),
                f"{SSIM_VARIANT}; {hidden_map}; {RESIZE_RULE}",
                f"scikit-image {version('scikit-image')}",
            ),
        )

    def compute(self, given: MetricInput) -> dict[str, Score]:
        """Score the renders at the cameras of ``case.true_views``. Raises `BadInput` if their number is wrong."""
        reason = no_true_view(given)
        if reason is not None:
            return {name: Score(None, 0, reason) for name in ("psnr", "ssim", "hole_psnr", "hole_ssim")}
        views, renders = given.case.true_views, matched_renders(given)
        full = [psnr_of_mse(mean_squared_error(r, v.image)) for r, v in zip(renders, views, strict=True)]
        return {
            "psnr": mean_over_views(full, [IDENTICAL if math.isinf(x) else "" for x in full]),
            "ssim": mean_over_views(*_ssim_values(renders, views)),
            "hole_psnr": mean_over_views(*_hidden_values(renders, views)),
            "hole_ssim": mean_over_views(*_hidden_ssim_values(renders, views)),
        }


class InputPsnr:
    """PSNR of the method's render at the input camera against the input, after a bounded half-pixel registration."""

    def specs(self, weights_dir: Path | None) -> tuple[MetricSpec, ...]:
        """The spec of `input_psnr`."""
        variant = (
            f"{PSNR_VARIANT}, {BORDER} px border left out; best of 25 shifts of -1..1 px in half-pixel steps "
            f"(bilinear); {RESIZE_RULE}"
        )
        return (MetricSpec("input_psnr", "PSNR, input view (dB)", True, (0.0, None), variant, "bench 1", 2),)

    def compute(self, given: MetricInput) -> dict[str, Score]:
        """Score ``output.input_view``; ``detail`` holds the shift, the unregistered PSNR and the SSIM."""
        view = given.output.input_view
        if view is None:
            return {"input_psnr": Score(None, 0, "the method has no view at the input camera")}
        view = resize_to(view, given.case.image.shape[1], given.case.image.shape[0])
        return {"input_psnr": _register(view, given.case)}


def no_true_view(given: MetricInput) -> str | None:
    """Why nothing can be compared with a true view; None if something can."""
    if not given.case.true_views:
        return "no true view in this data set"
    if given.output.true_views is None:
        return "the method cannot render at the true view's camera"
    return None


def matched_renders(given: MetricInput) -> list[UInt8Array]:
    """The method's renders in the true views' sizes, in order. Raises `BadInput` unless there is one for each."""
    views, renders = given.case.true_views, given.output.true_views or ()
    if len(renders) != len(views):
        raise BadInput(
            f"{len(renders)} renders for {len(views)} true views",
            "one render for each true view, in order",
            "fix the adapter, or give None when it cannot render there",
        )
    return [resize_to(r, v.image.shape[1], v.image.shape[0]) for r, v in zip(renders, views, strict=True)]


def _ssim_values(renders: list[UInt8Array], views: tuple[TrueView, ...]) -> tuple[list[float], list[str]]:
    values, reasons = [], []
    for render, view in zip(renders, views, strict=True):
        fits = min(view.image.shape[:2]) >= SSIM_WINDOW
        values.append(ssim(render, view.image) if fits else math.nan)
        reasons.append("" if fits else f"the true view is smaller than the {SSIM_WINDOW}x{SSIM_WINDOW} window")
    return values, reasons


def _hidden_values(renders: list[UInt8Array], views: tuple[TrueView, ...]) -> tuple[list[float], list[str]]:
    values, reasons = [], []
    for render, view in zip(renders, views, strict=True):
        if not view.hidden.any():
            values.append(math.nan)
            reasons.append(NOTHING_HIDDEN)
            continue
        values.append(psnr_of_mse(mean_squared_error(render, view.image, view.hidden)))
        reasons.append(IDENTICAL if math.isinf(values[-1]) else "")
    return values, reasons


def _hidden_ssim_values(renders: list[UInt8Array], views: tuple[TrueView, ...]) -> tuple[list[float], list[str]]:
    values, reasons = [], []
    for render, view in zip(renders, views, strict=True):
        fits = min(view.image.shape[:2]) >= SSIM_WINDOW
        value = ssim_inside(render, view.image, view.hidden) if fits else None
        values.append(math.nan if value is None else value)
        small = f"no whole {SSIM_WINDOW}x{SSIM_WINDOW} window around a hidden pixel"
        reasons.append((small if view.hidden.any() else NOTHING_HIDDEN) if value is None else "")
    return values, reasons


def mean_over_views(values: list[float], reasons: list[str]) -> Score:
    """Mean over the views; without a value if any view has none, since a mean over fewer views is another score."""
    per_view = tuple(float(x) if math.isfinite(x) else None for x in values)
    missing = [reason for x, reason in zip(per_view, reasons, strict=True) if x is None]
    if missing:
        return Score(None, 0, missing[0], per_view)
    return Score(float(np.mean(values)), len(values), None, per_view)


def _register(view: UInt8Array, case: SceneCase) -> Score:
    """Best PSNR over the allowed shifts; a tie goes to the smallest shift."""
    by_shift = {(dx, dy): _inner_mse(_shifted(view, dx, dy), case.image) for dx in SHIFTS for dy in SHIFTS}
    best = min(by_shift, key=lambda shift: (by_shift[shift], abs(shift[0]) + abs(shift[1])))
    unregistered = psnr_of_mse(by_shift[0.0, 0.0])
    detail: dict[str, Any] = {
        "shift": list(best),
        "unregistered": unregistered if math.isfinite(unregistered) else None,
        "ssim": ssim(view, case.image) if min(view.shape[:2]) >= SSIM_WINDOW else None,
    }
    if by_shift[best] == 0:
        return Score(None, 0, IDENTICAL, None, detail)
    return Score(psnr_of_mse(by_shift[best]), 1, None, None, detail)


def _shifted(view: UInt8Array, dx: float, dy: float) -> UInt8Array:
    if dx == 0 and dy == 0:
        return view
    move = np.array([[1, 0, dx], [0, 1, dy]], np.float64)
    size = (view.shape[1], view.shape[0])
    moved = cv2.warpAffine(view, move, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(moved, np.uint8)


def _inner_mse(view: UInt8Array, reference: UInt8Array) -> float:
    """MSE without the border that a shift moves in from outside; of everything where the image is too small for one."""
    if min(view.shape[:2]) <= 2 * BORDER:
        return mean_squared_error(view, reference)
    inner = (slice(BORDER, -BORDER), slice(BORDER, -BORDER))
    return mean_squared_error(view[inner], reference[inner])
