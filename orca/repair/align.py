"""Fit a predicted depth to the reconstruction's: d = a d_pred + b, outliers rejected (paper, "Disocclusion Repair")."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np

from orca.conventions import Float32Array, Float64Array
from orca.errors import BadInput, OrcaError
from orca.repair.components import BoolArray

__all__ = ["AffineFit", "AlignmentFailed", "blend_boundary", "robust_affine"]

_STARTS = 12
_SAMPLE = 2048
_TRIM = 0.5
_CONCENTRATION_STEPS = 5
_REFITS = 10


class AlignmentFailed(OrcaError):
    """A predicted depth does not fit the reconstruction; the caller falls back to local repair and records it."""

    kind = "alignment_failed"


@dataclass(frozen=True)
class AffineFit:
    """Depth alignment d = a d_pred + b.

    Attributes:
        a: scale, positive.
        b: shift, in units of the target depth.
        inlier_share: share of the samples within the tolerance, 0 to 1.
    """

    a: float
    b: float
    inlier_share: float

    def apply(self, pred: Float32Array) -> Float32Array:
        """Aligned depth, same shape as ``pred``."""
        return (self.a * pred.astype(np.float64) + self.b).astype(np.float32)


def robust_affine(
    pred: Float32Array,
    target: Float32Array,
    *,
    tolerance: float = 0.05,
    min_inliers: int = 32,
    min_inlier_share: float = 0.5,
) -> AffineFit:
    """Least trimmed squares from a fixed set of starting lines, then least squares on the inliers.

    Nothing is drawn at random: the starts are the lines through pairs of bin medians of the samples sorted by
    ``pred``, so outliers that are fewer than half of the samples cannot pull all of them.

    Args:
        pred: predicted depth at valid background pixels, [n].
        target: depth of the reconstruction there, [n], positive.
        tolerance: O. A sample is an inlier if it is reproduced to this share of its depth.
        min_inliers: O. Fewest inliers.
        min_inlier_share: O. Smallest share of inliers.

    Raises:
        BadInput: the two arrays are not vectors of one length.
        AlignmentFailed: too few usable samples, too few inliers, a constant prediction, or a <= 0.
    """
    if pred.ndim != 1 or pred.shape != target.shape:
        raise BadInput(f"depths of shapes {pred.shape} and {target.shape}", "two vectors of one length", "pair them")
    usable = np.isfinite(pred) & np.isfinite(target) & (target > 0)
    x, y = pred[usable].astype(np.float64), target[usable].astype(np.float64)
    if len(x) < min_inliers:
        raise _failed(f"{len(x)} usable depth samples", f"at least {min_inliers}")
    if np.ptp(x) <= 1e-9 * max(1.0, float(np.abs(x).max())):
        raise _failed("a constant predicted depth", "a prediction that varies over the background")
    line = _best_start(x, y)
    inlier = np.abs(line[0] * x + line[1] - y) <= tolerance * y
    for _ in range(_REFITS):
        if np.count_nonzero(inlier) < 2 or np.ptp(x[inlier]) == 0:
            break
        line = _least_squares(x[inlier], y[inlier])
        previous, inlier = inlier, np.abs(line[0] * x + line[1] - y) <= tolerance * y
        if np.array_equal(previous, inlier):
            break
    return _checked(line, inlier, min_inliers, min_inlier_share)


def _checked(line: tuple[float, float], inlier: BoolArray, min_inliers: int, min_share: float) -> AffineFit:
    """The fit, or a typed failure that says which requirement it misses."""
    count, share = int(np.count_nonzero(inlier)), float(np.mean(inlier))
    if count < min_inliers or share < min_share:
        raise _failed(f"{count} inliers ({share:.0%})", f"at least {min_inliers} and {min_share:.0%}")
    if line[0] <= 0:
        raise _failed(f"a depth scale of {line[0]:.3g}", "a positive scale")
    return AffineFit(line[0], line[1], share)


def _failed(given: str, allowed: str) -> AlignmentFailed:
    return AlignmentFailed(f"depth alignment: {given}", allowed, "repair this region locally")


def _best_start(x: Float64Array, y: Float64Array) -> tuple[float, float]:
    """The line of least trimmed squares that a few concentration steps reach from any of the fixed starts."""
    rank = np.argsort(x, kind="stable")
    rank = rank[np.linspace(0, len(rank) - 1, min(len(rank), _SAMPLE)).astype(int)]
    x, y = x[rank], y[rank]
    bins = np.array_split(np.arange(len(x)), min(_STARTS, len(x)))
    middles = [(float(np.median(x[b])), float(np.median(y[b]))) for b in bins]
    starts = [_least_squares(x, y)]
    for (xa, ya), (xb, yb) in combinations(middles, 2):
        if xb > xa:
            starts.append(((yb - ya) / (xb - xa), ya - (yb - ya) / (xb - xa) * xa))
    keep = max(2, int(np.ceil(_TRIM * len(x))))
    best, best_cost = starts[0], np.inf
    for line in starts:
        refined, cost = _concentrate(x, y, line, keep)
        if cost < best_cost:
            best, best_cost = refined, cost
    return best


def _concentrate(
    x: Float64Array, y: Float64Array, line: tuple[float, float], keep: int
) -> tuple[tuple[float, float], float]:
    """Refit on the ``keep`` best samples a few times; each step lowers the trimmed sum of squares."""
    for _ in range(_CONCENTRATION_STEPS):
        residual = np.abs(line[0] * x + line[1] - y)
        best = np.argpartition(residual, keep - 1)[:keep]
        if np.ptp(x[best]) == 0:
            break
        line = _least_squares(x[best], y[best])
    residual = np.sort(np.abs(line[0] * x + line[1] - y))[:keep]
    return line, float(np.sum(residual**2))


def _least_squares(x: Float64Array, y: Float64Array) -> tuple[float, float]:
    xm, ym = float(np.mean(x)), float(np.mean(y))
    a = float(np.sum((x - xm) * (y - ym)) / np.sum((x - xm) ** 2))
    return a, ym - a * xm


def blend_boundary(aligned: Float32Array, background: Float32Array, hole: BoolArray, width: float) -> Float32Array:
    """Depth of a completed region: the background's at its boundary, the aligned prediction from ``width`` pixels in.

    Args:
        aligned: aligned predicted depth, [H, W].
        background: depth of the reconstruction, continued into the hole (`local_fill`), [H, W].
        hole: the completed region, [H, W].
        width: pixels over which one passes smoothly into the other. The image border is no boundary of the hole.

    Returns:
        Depth [H, W]; ``background`` outside the hole.
    """
    if not aligned.shape == background.shape == hole.shape or hole.ndim != 2:
        raise BadInput(
            f"shapes {aligned.shape}, {background.shape}, {hole.shape}", "three arrays [H, W]", "crop them alike"
        )
    distance = cv2.distanceTransform(hole.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5)
    ramp = np.clip(distance / max(width, 1e-6), 0.0, 1.0)
    weight = ramp * ramp * (3.0 - 2.0 * ramp)
    # np.where and not a product: either side may be NaN where the other alone is meant.
    mixed = (1.0 - weight) * background + weight * aligned
    mixed = np.where(weight >= 1.0, aligned, mixed)
    return np.where(hole, mixed, background).astype(np.float32)
