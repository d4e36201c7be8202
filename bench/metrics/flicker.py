"""Flicker: what changes between consecutive frames at points whose place in both is known.

Symmetric epipolar distances see only motion across the epipolar lines; a surface that swims along them, a texture that
is repainted in every frame, or a brightness that pumps, all score a perfect TSED. Where depth is known the place of a
point in the next frame is known exactly, and the two colours can be compared: the warping error of video work (Lai et
al., "Learning blind video temporal consistency", ECCV 2018), with geometry in the place of optical flow.

Lower is better, but a grey video has none: it is to be read beside `visible_psnr`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from bench.adapters.adapter import MethodOutput
from bench.datasets.case import SceneCase
from bench.metrics.fidelity import RESIZE_RULE, read_at, resize_to
from bench.metrics.metric import MetricInput, MetricSpec, Score
from bench.metrics.sure import SURE_RULE, sure_masks
from bench.warping import depth_edges, project_depth
from orca.camera import Camera
from orca.conventions import Float32Array, Float64Array, UInt8Array
from orca.errors import BadInput

__all__ = ["NO_DEPTH", "Flicker"]

NO_DEPTH = "the method gives no depth of its frames"
MIN_SHARE = 0.01
# A frame read between its pixels is a little blurred, read on them it is not. Both are smoothed first, so that this
# does not count: an exact video of a photographed plane then has 0.3 levels instead of 1.0 (measured).
SMOOTHING_PX = 1.0
# As in `bench.warping.sure_points`.
DEPTH_TOLERANCE = 0.02
EDGE_RATIO = 1.05
COVERED = 0.5
_STRETCHES = 8  # of a path, that the cores take one at a time

V = TypeVar("V")


class Flicker:
    """Mean absolute difference of the colours of one point in consecutive frames, in levels of 0..255.

    `flicker` takes the points that the input shows, by the reference depth: the same points for every method. And
    `flicker_own_depth` takes every point of each frame, by the depth that the method rendered with it.
    """

    def specs(self, weights_dir: Path | None) -> tuple[MetricSpec, ...]:
        """Specs of `flicker` and `flicker_own_depth`."""
        common = (
            f"mean |difference| of colours (0..255), frames smoothed by a Gaussian of {SMOOTHING_PX:g} px; "
            f"mean over consecutive pairs with >= {MIN_SHARE:.0%} of the pixels"
        )
        own = f"points of frame i seen in i + 1 by the method's depth, within {DEPTH_TOLERANCE:.0%}, no depth edge"
        version = f"bench 1, opencv {cv2.__version__}"
        reference = f"input pixels in both frames by the reference depth; {SURE_RULE}; {common}; {RESIZE_RULE}"
        return (
            MetricSpec("flicker", "Flicker", False, (0.0, 255.0), reference, version, 2),
            MetricSpec("flicker_own_depth", "Flicker, own depth", False, (0.0, 255.0), f"{own}; {common}", version, 2),
        )

    def compute(self, given: MetricInput) -> dict[str, Score]:
        """Score the frames. Raises `BadInput` for other frames or depths than one for each evaluated camera."""
        case, output = given.case, given.output
        _check(case, output)
        if len(output.frames) < 2:
            few = Score(None, 0, "fewer than two frames")
            return {"flicker": few, "flicker_own_depth": few}
        own = (
            Score(None, 0, NO_DEPTH) if output.frame_depth is None else _by_own_depth(case, output, output.frame_depth)
        )
        return {"flicker": _by_reference_depth(case, output.frames), "flicker_own_depth": own}


@dataclass(frozen=True)
class _Pair:
    """One pair of frames.

    Attributes:
        compared: share of the points that are compared.
        residual: mean absolute difference over them, levels; None if they are too few.
        occluded: share of the points that lie behind a surface of the next frame.
        contradicted: share of the points that the next frame looks through, onto a surface behind them.
    """

    compared: float
    residual: float | None
    occluded: float | None = None
    contradicted: float | None = None


def _check(case: SceneCase, output: MethodOutput) -> None:
    frames, depth = output.frames, output.frame_depth
    if len(frames) != len(case.eval_indices):
        raise BadInput(
            f"{len(frames)} frames for {len(case.eval_indices)} evaluated cameras",
            "one frame for each evaluated camera",
            "fix the adapter",
        )
    if frames.dtype != np.uint8 or frames.ndim != 4 or frames.shape[3] != 3:
        raise BadInput(f"frames of shape {frames.shape}, {frames.dtype}", "uint8 [n, H, W, 3]", "fix the adapter")
    if depth is not None and depth.shape != frames.shape[:3]:
        raise BadInput(
            f"depth of shape {depth.shape} for frames of shape {frames.shape}",
            "[n, H, W], one map for each frame and of its size",
            "fix the adapter",
        )


def _by_reference_depth(case: SceneCase, frames: UInt8Array) -> Score:
    cameras = case.eval_trajectory.cameras()
    masks = list(sure_masks(case))

    def place(i: int) -> _Place:
        frame = resize_to(frames[i], cameras[i].width, cameras[i].height)
        return _Place(masks[i], project_depth(case.depth, case.camera, cameras[i]).pixels, _smooth(frame))

    pairs = _over_pairs(place, _reference_pair, len(frames))
    return _score(pairs, {"geometry": "reference depth", "depth_source": case.depth_source})


def _by_own_depth(case: SceneCase, output: MethodOutput, depths: Float32Array) -> Score:
    height, width = output.frames.shape[1:3]
    cameras = [camera.resized(width, height) for camera in case.eval_trajectory.cameras()]

    def view(i: int) -> _View:
        return _View(cameras[i], _smooth(output.frames[i]), _covered(output, i, depths[i]))

    pairs = _over_pairs(view, _own_pair, len(output.frames))
    return _score(pairs, {"geometry": "depth rendered by the method"})


def _over_pairs(view: Callable[[int], V], compare: Callable[[V, V], _Pair], count: int) -> list[_Pair]:
    """``compare`` every two consecutive of ``count`` views, stretches of the path on a core each."""
    from orca.threads import map_on_cores  # loads torch

    step = -(-(count - 1) // _STRETCHES)

    def stretch(first: int) -> list[_Pair]:
        views = (view(i) for i in range(first, min(first + step, count - 1) + 1))
        return [compare(one, other) for one, other in pairwise(views)]

    return [pair for pairs in map_on_cores(stretch, range(0, count - 1, step)) for pair in pairs]


@dataclass(frozen=True, eq=False)
class _Place:
    """Where the input's pixels are in a frame: the sure ones [n], positions [n, 2], and the frame."""

    sure: NDArray[np.bool_]
    pixels: Float64Array
    frame: Float32Array


def _reference_pair(first: _Place, second: _Place) -> _Pair:
    both = first.sure & second.sure
    at = np.flatnonzero(both)
    here, there = (read_at(place.frame, place.pixels.take(at, axis=0)) for place in (first, second))
    return _compared(here, there, both)


@dataclass(frozen=True, eq=False)
class _View:
    camera: Camera
    frame: Float32Array
    depth: Float32Array


def _own_pair(first: _View, second: _View) -> _Pair:
    """Warp frame 1 into frame 2 by the depth of frame 1; frame 2 is read at the exact positions."""
    projection = project_depth(first.depth, first.camera, second.camera)
    seen = ~depth_edges(first.depth, EDGE_RATIO).ravel()
    there = np.where(depth_edges(second.depth, EDGE_RATIO), np.float32(np.nan), second.depth).ravel()
    total, occluded, contradicted = _keep_seen(projection.z, projection.index, there, DEPTH_TOLERANCE, seen)
    at = np.flatnonzero(seen)
    here = first.frame.reshape(-1, 3).take(at, axis=0)
    pair = _compared(here, read_at(second.frame, projection.pixels.take(at, axis=0)), seen)
    return _Pair(pair.compared, pair.residual, occluded / max(1, total), contradicted / max(1, total))


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _keep_seen(
    z: Float64Array, index: NDArray[np.int64], there: Float32Array, tolerance: float, seen: NDArray[np.bool_]
) -> tuple[int, int, int]:
    """Clear ``seen`` but where a point lies on the surface ``there``; counts of points asked, behind and before it."""
    total, behind, before = 0, 0, 0
    for i in range(len(seen)):
        if not seen[i] or index[i] < 0:
            seen[i] = False
            continue
        total += 1
        surface = np.float64(there[index[i]])
        if z[i] > surface * (1 + tolerance):
            behind += 1
            seen[i] = False
        elif z[i] < surface * (1 - tolerance):
            before += 1
            seen[i] = False
        elif not np.isfinite(surface):
            seen[i] = False
    return total, behind, before


def _compared(first: Float32Array, second: Float32Array, mask: NDArray[np.bool_]) -> _Pair:
    share = float(mask.mean())
    if share < MIN_SHARE:
        return _Pair(share, None)
    return _Pair(share, float(np.mean(np.abs(first - second), dtype=np.float64)))


def _smooth(frame: UInt8Array) -> Float32Array:
    return np.asarray(
        cv2.GaussianBlur(frame.astype(np.float32), (0, 0), SMOOTHING_PX, borderType=cv2.BORDER_REPLICATE), np.float32
    )


def _covered(output: MethodOutput, i: int, depth: Float32Array) -> Float32Array:
    """The depth where there is a surface; NaN elsewhere."""
    known = np.isfinite(depth) & (depth > 0)
    if output.coverage is not None:
        known &= output.coverage[i] >= COVERED
    return np.where(known, depth, np.nan).astype(np.float32)


def _score(pairs: Sequence[_Pair], detail: dict[str, Any]) -> Score:
    per_pair = tuple(pair.residual for pair in pairs)
    kept = [x for x in per_pair if x is not None]
    facts = {
        **detail,
        "compared_share": [round(pair.compared, 4) for pair in pairs],
        "pairs_with_too_few_points": len(per_pair) - len(kept),
    }
    for name in ("occluded", "contradicted"):
        shares = [share for pair in pairs if (share := getattr(pair, name)) is not None]
        if shares:
            facts[f"{name}_share"] = round(float(np.mean(shares)), 4)
    if not kept:
        return Score(None, 0, f"no pair of frames has {MIN_SHARE:.0%} of its points in both", per_pair, facts)
    return Score(float(np.mean(kept)), len(kept), None, per_pair, facts)
