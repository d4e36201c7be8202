"""Visible-content fidelity: what the input showed must look the same from the new viewpoint."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.datasets.case import SceneCase
from bench.metrics.fidelity import RESIZE_RULE, psnr_of_mse, read_at, resize_to
from bench.metrics.metric import MetricInput, MetricSpec, Score
from bench.metrics.sure import SURE_RULE, sure_masks
from bench.warping import project_depth
from orca.camera import Camera
from orca.conventions import UInt8Array
from orca.errors import BadInput

__all__ = ["VisiblePsnr"]

MIN_SHARE = 0.01


class VisiblePsnr:
    """PSNR of the novel views where the input surely showed their content.

    Each sure input pixel (`bench.warping.sure_points`) is projected with the reference depth, the frame is read there
    bilinearly, and the two colours are compared. Reading at the exact position instead of comparing rounded splats
    gives the true second photograph of the motorcycle pair 30.6 dB instead of 29.5: less error of the ruler itself.
    """

    def specs(self, weights_dir: Path | None) -> tuple[MetricSpec, ...]:
        """The spec of `visible_psnr`."""
        variant = (
            "frame read bilinearly at the projected positions of the input pixels (reference depth), compared with "
            "their colours; "
            f"{SURE_RULE}; mean over frames with >= {MIN_SHARE:.0%} sure pixels and a finite PSNR; {RESIZE_RULE}"
        )
        version = f"bench 1, opencv {cv2.__version__}"
        return (MetricSpec("visible_psnr", "PSNR, visible part (dB)", True, (0.0, None), variant, version, 2),)

    def compute(self, given: MetricInput) -> dict[str, Score]:
        """Score the frames. Raises `BadInput` if there is not one frame for each evaluated camera."""
        case, output = given.case, given.output
        if output.model.get("is_warp_reference"):
            return {"visible_psnr": Score(None, 0, "the warp baselines are that reference")}
        if len(output.frames) != len(case.eval_indices):
            raise BadInput(
                f"{len(output.frames)} frames for {len(case.eval_indices)} evaluated cameras",
                "one frame for each evaluated camera",
                "fix the adapter",
            )
        masks = sure_masks(case)
        cameras = case.eval_trajectory.cameras()
        from orca.threads import map_on_cores  # loads torch

        mses = map_on_cores(lambda view: _frame_mse(case, *view), zip(cameras, output.frames, masks, strict=True))
        return {"visible_psnr": _score(mses, masks.shares)}


def _frame_mse(case: SceneCase, camera: Camera, frame: UInt8Array, sure: NDArray[np.bool_]) -> float | None:
    """Pooled MSE over the sure pixels; None when there are too few of them."""
    if sure.mean() < MIN_SHARE:
        return None
    frame = resize_to(frame, camera.width, camera.height)
    at = np.flatnonzero(sure)
    positions = project_depth(case.depth, case.camera, camera).pixels.take(at, axis=0)
    difference = read_at(frame, positions) - case.image.reshape(-1, 3).take(at, axis=0)
    return float(np.mean(difference.astype(np.float64) ** 2))


def _score(mses: list[float | None], shares: tuple[float, ...]) -> Score:
    values = [None if mse is None else psnr_of_mse(mse) for mse in mses]
    detail = {
        "sure_share": [round(share, 4) for share in shares],
        "frames_with_too_few_sure_pixels": values.count(None),
        "identical_frames": sum(1 for x in values if x is not None and math.isinf(x)),
    }
    per_frame = tuple(x if x is not None and math.isfinite(x) else None for x in values)
    kept = [x for x in per_frame if x is not None]
    if kept:
        return Score(float(np.mean(kept)), len(kept), None, per_frame, detail)
    if detail["identical_frames"]:
        reason = "identical to the input on all sure pixels (infinite PSNR)"
    else:
        reason = f"no frame has at least {MIN_SHARE:.0%} sure pixels" if values else "no frames"
    return Score(None, 0, reason, per_frame, detail)
