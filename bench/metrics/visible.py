"""Visible-content fidelity: what the input showed must look the same from the new viewpoint."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.datasets.case import SceneCase
from bench.metrics.fidelity import RESIZE_RULE, psnr_of_mse, resize_to
from bench.metrics.metric import MetricInput, MetricSpec, Score
from bench.warping import project_depth, sure_points
from orca.camera import Camera
from orca.conventions import Float32Array, Float64Array, UInt8Array
from orca.errors import BadInput

__all__ = ["VisiblePsnr"]

MIN_SHARE = 0.01
CASES_KEPT = 32
ROW = 4096


class VisiblePsnr:
    """PSNR of the novel views where the input surely showed their content.

    Each sure input pixel (`bench.warping.sure_points`) is projected with the reference depth, the frame is read there
    bilinearly, and the two colours are compared. Reading at the exact position instead of comparing rounded splats
    gives the true second photograph of the motorcycle pair 30.6 dB instead of 29.5: less error of the ruler itself.
    """

    def __init__(self) -> None:
        # One splat a scene and frame, not one a method: a run scores many methods on the same scenes.
        self._masks = lru_cache(maxsize=CASES_KEPT)(_sure_masks)

    def specs(self, weights_dir: Path | None) -> tuple[MetricSpec, ...]:
        """The spec of `visible_psnr`."""
        variant = (
            "frame read bilinearly at the projected positions of the input pixels (reference depth), compared with "
            "their colours; sure pixels: occlusion window 5 px, depth tolerance 2 %, no depth edge > 5 % in 3x3; "
            f"mean over frames with >= {MIN_SHARE:.0%} sure pixels and a finite PSNR; {RESIZE_RULE}"
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
        masks = self._masks(_CaseKey.of(case))
        mses = [
            _frame_mse(case, camera, frame, sure)
            for camera, frame, sure in zip(_cameras(case), output.frames, _unpack(masks, case), strict=True)
        ]
        return {"visible_psnr": _score(mses, masks.shares)}


@dataclass(frozen=True)
class _CaseKey:
    """A scene case that equals another when everything the sure pixels depend on is equal."""

    sha256: str
    case: SceneCase = field(compare=False, repr=False)

    @staticmethod
    def of(case: SceneCase) -> _CaseKey:
        digest = hashlib.sha256(case.eval_trajectory.sha256.encode())
        for array in (case.depth, case.camera.K, case.camera.world_to_camera):
            digest.update(str(array.shape).encode())
            digest.update(np.ascontiguousarray(array).tobytes())
        return _CaseKey(digest.hexdigest(), case)


@dataclass(frozen=True, eq=False)
class _SureMasks:
    """Sure input pixels of every evaluated frame, one bit each."""

    packed: tuple[NDArray[np.uint8], ...]
    shares: tuple[float, ...]


def _cameras(case: SceneCase) -> tuple[Camera, ...]:
    return case.eval_trajectory.cameras()


def _sure_masks(key: _CaseKey) -> _SureMasks:
    """Sure pixels of every evaluated frame (32 kB for a frame of 512x512)."""
    sure = [sure_points(key.case.depth, key.case.camera, camera)[0] for camera in _cameras(key.case)]
    return _SureMasks(tuple(np.packbits(mask) for mask in sure), tuple(float(mask.mean()) for mask in sure))


def _unpack(masks: _SureMasks, case: SceneCase) -> Iterator[NDArray[np.bool_]]:
    for packed in masks.packed:
        yield np.unpackbits(packed, count=case.depth.size).astype(np.bool_)


def _frame_mse(case: SceneCase, camera: Camera, frame: UInt8Array, sure: NDArray[np.bool_]) -> float | None:
    """Pooled MSE over the sure pixels; None when there are too few of them."""
    if sure.mean() < MIN_SHARE:
        return None
    frame = resize_to(frame, camera.width, camera.height)
    positions = project_depth(case.depth, case.camera, camera).pixels[sure]
    difference = _read(frame, positions) - case.image.reshape(-1, 3)[sure]
    return float(np.mean(difference.astype(np.float64) ** 2))


def _read(frame: UInt8Array, positions: Float64Array) -> Float32Array:
    """Colours of a frame at (x, y) positions [n, 2], bilinear, [n, 3]."""
    count = len(positions)
    # OpenCV maps are images of at most 32767 a side and count pixels from their centres: fold and shift.
    folded = np.zeros((-(-count // ROW) * ROW, 2), np.float32)
    folded[:count] = positions - 0.5
    grid = folded.reshape(-1, ROW, 2)
    colours = cv2.remap(
        frame.astype(np.float32), grid[..., 0], grid[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(colours.reshape(-1, 3)[:count], np.float32)


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
