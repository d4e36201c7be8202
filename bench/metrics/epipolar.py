"""Two-view geometry of two known cameras: fundamental matrix, homography, and the distances of matches to them.

Everything is float64, in pixels, with the centre of the top-left pixel at (0.5, 0.5). A distance that is not finite
(a match on the epipole, a degenerate matrix) is returned as infinity, never NaN: one match must not poison a median.
"""

from __future__ import annotations

import numpy as np

from orca.camera import Camera
from orca.conventions import Float64Array

__all__ = [
    "fundamental_matrix",
    "homography_transfer_distance",
    "infinite_homography",
    "is_zero_baseline",
    "largest_center_norm",
    "relative_pose",
    "symmetric_epipolar_distance",
]

# A baseline is zero when it is below this share of the largest camera-centre norm: float32 poses leave about 1e-7.
ZERO_BASELINE_SHARE = 1e-6
# ... and below this many trajectory units, where the cameras themselves sit at the origin: 1e-8 R of baseline at a
# depth of 1 R is 1e-5 px of parallax.
ZERO_BASELINE_FLOOR = 1e-8


def relative_pose(first: Camera, second: Camera) -> tuple[Float64Array, Float64Array]:
    """R [3, 3] and t [3] with X2 = R X1 + t between the camera axes of two views."""
    pose = second.world_to_camera @ np.linalg.inv(first.world_to_camera)
    return np.asarray(pose[:3, :3]), np.asarray(pose[:3, 3])


def largest_center_norm(cameras: tuple[Camera, ...]) -> float:
    """max |C| over the cameras: the length against which a baseline counts as zero."""
    return max((float(np.linalg.norm(camera.center)) for camera in cameras), default=0.0)


def is_zero_baseline(first: Camera, second: Camera, extent: float) -> bool:
    """True if two cameras share one centre, up to the rounding of float32 poses.

    Args:
        first, second: the two views.
        extent: max |C| over the whole sequence, in the units of the poses (see `largest_center_norm`).
    """
    _, t = relative_pose(first, second)
    return bool(np.linalg.norm(t) <= max(ZERO_BASELINE_SHARE * extent, ZERO_BASELINE_FLOOR))


def fundamental_matrix(first: Camera, second: Camera) -> Float64Array:
    """F = K2^-T [t]x R K1^-1, [3, 3]: x2^T F x1 = 0 for homogeneous pixels of one point (Hartley & Zisserman, 9.2).

    Each camera brings its own K. The zero matrix where the baseline is exactly zero.
    """
    R, t = relative_pose(first, second)
    cross = np.array([[0.0, -t[2], t[1]], [t[2], 0.0, -t[0]], [-t[1], t[0], 0.0]])
    return np.asarray(np.linalg.inv(second.K).T @ cross @ R @ np.linalg.inv(first.K))


def infinite_homography(first: Camera, second: Camera) -> Float64Array:
    """H = K2 R K1^-1, [3, 3]: the exact pixel map of two views from one centre."""
    R, _ = relative_pose(first, second)
    return np.asarray(second.K @ R @ np.linalg.inv(first.K))


def symmetric_epipolar_distance(F: Float64Array, x1: Float64Array, x2: Float64Array) -> Float64Array:
    """Half the sum of the two unsquared point-to-epipolar-line distances of each match, [n], pixels.

    This is the distance of TSED (Yu et al., ICCV 2023), not the sum of squares that goes by the same name elsewhere.

    Args:
        F: fundamental matrix with x2^T F x1 = 0, [3, 3]; its scale and sign do not matter.
        x1, x2: matched pixels of the two views, [n, 2].
    """
    h1, h2 = _homogeneous(x1), _homogeneous(x2)
    lines2, lines1 = h1 @ F.T, h2 @ F
    residual = np.abs(np.sum(lines2 * h2, axis=1))
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = 0.5 * (residual / np.hypot(*lines1[:, :2].T) + residual / np.hypot(*lines2[:, :2].T))
    return _finite_or_inf(distance)


def homography_transfer_distance(H: Float64Array, x1: Float64Array, x2: Float64Array) -> Float64Array:
    """Half the sum of |x2 - H x1| and |x1 - H^-1 x2| of each match, [n], pixels (symmetric transfer, unsquared).

    Args:
        H: homography from view 1 to view 2, [3, 3]; infinite distances if it is singular.
        x1, x2: matched pixels, [n, 2].
    """
    if not np.isfinite(H).all() or np.linalg.matrix_rank(H) < 3:
        return np.full(len(x1), np.inf)
    forward = np.linalg.norm(_transfer(H, x1) - x2, axis=1)
    backward = np.linalg.norm(_transfer(np.asarray(np.linalg.inv(H), np.float64), x2) - x1, axis=1)
    return _finite_or_inf(0.5 * (forward + backward))


def _homogeneous(points: Float64Array) -> Float64Array:
    xy = np.asarray(points, np.float64).reshape(-1, 2)
    return np.concatenate([xy, np.ones((len(xy), 1))], axis=1)


def _transfer(H: Float64Array, points: Float64Array) -> Float64Array:
    mapped = _homogeneous(points) @ H.T
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(mapped[:, :2] / mapped[:, 2:])


def _finite_or_inf(distance: Float64Array) -> Float64Array:
    return np.where(np.isfinite(distance), distance, np.inf)
