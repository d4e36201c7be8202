"""Two-view geometry estimated from the matches themselves, for renders whose cameras nobody knows.

Two views of a plane, or from one place, fit a homography, and then any fundamental matrix of a whole family fits as
well. So both models are estimated, and the homography is preferred where it explains the matches.

Facts about OpenCV that this file is built around: ``cv2.setRNGSeed`` has no effect on USAC (its state is a parameter),
parallel USAC is not repeatable, USAC raises below 7 points, may return None at 8, and answers collinear or identical
points with an arbitrary matrix and 100 % inliers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.metrics.epipolar import homography_transfer_distance, symmetric_epipolar_distance
from orca.conventions import Float64Array

__all__ = ["EstimatedModel", "EstimatorConfig", "epipolar_inliers", "estimate_model"]


@dataclass(frozen=True)
class EstimatorConfig:
    """MAGSAC++ (Barath et al. 2020) through OpenCV's USAC.

    Attributes:
        threshold: inlier distance, pixels.
        confidence: of the sampler's stopping rule.
        max_iterations: of the sampler.
        seed: state of the random generator, the same for every pair.
        homography_share: H is chosen when it has at least this share of the inliers of F.
        min_matches: fewer than this prove nothing: an estimated F explains 12 random matches 98 % of the time.
        min_inlier_ratio: smallest share of inliers of the chosen model.
        min_spread: the matches of each view must spread over more than this across their main direction, pixels.
    """

    threshold: float = 1.0
    confidence: float = 0.999
    max_iterations: int = 10_000
    seed: int = 0
    homography_share: float = 0.8
    min_matches: int = 20
    min_inlier_ratio: float = 0.5
    min_spread: float = 1.0


@dataclass(frozen=True, eq=False)
class EstimatedModel:
    """The model chosen for one pair.

    Attributes:
        name: "F" (fundamental matrix) or "H" (homography).
        distance: of every match to the model, [n], pixels.
        inlier_ratio: share of matches within the threshold.
    """

    name: Literal["F", "H"]
    distance: Float64Array
    inlier_ratio: float


def estimate_model(x1: Float64Array, x2: Float64Array, config: EstimatorConfig | None = None) -> EstimatedModel | None:
    """Fit F and H to the matches [n, 2] and choose; None where neither can be had.

    The choice is None for fewer than ``min_matches`` matches, and for points that lie on one line or in one place.
    """
    c = config or EstimatorConfig()
    if len(x1) < c.min_matches or min(_spread(x1), _spread(x2)) <= c.min_spread:
        return None
    to_lines = _distance_to_epipolar_lines(x1, x2, c)
    H = _fit(cv2.findHomography, x1, x2, c)
    to_points = None if H is None else homography_transfer_distance(H, x1, x2)
    lines_inliers = 0 if to_lines is None else int(np.sum(to_lines <= c.threshold))
    points_inliers = 0 if to_points is None else int(np.sum(to_points <= c.threshold))
    if to_points is not None and points_inliers >= c.homography_share * lines_inliers:
        return EstimatedModel("H", to_points, points_inliers / len(x1))
    if to_lines is not None:
        return EstimatedModel("F", to_lines, lines_inliers / len(x1))
    return None


def epipolar_inliers(x1: Float64Array, x2: Float64Array, config: EstimatorConfig | None = None) -> NDArray[np.bool_]:
    """Mask [n] of the matches within the threshold of an estimated F; all of them where no F can be had.

    As a filter before scoring with known cameras this deletes the evidence (a pair of 3.1 px becomes 1.1 px): for
    comparison with work that does so, never the default.
    """
    c = config or EstimatorConfig()
    if len(x1) < c.min_matches or min(_spread(x1), _spread(x2)) <= c.min_spread:
        return np.ones(len(x1), np.bool_)
    distance = _distance_to_epipolar_lines(x1, x2, c)
    return np.ones(len(x1), np.bool_) if distance is None else np.asarray(distance <= c.threshold)


def _distance_to_epipolar_lines(x1: Float64Array, x2: Float64Array, config: EstimatorConfig) -> Float64Array | None:
    F = _fit(cv2.findFundamentalMat, x1, x2, config)
    return None if F is None else symmetric_epipolar_distance(F, x1, x2)


def _fit(finder: Any, x1: Float64Array, x2: Float64Array, config: EstimatorConfig) -> Float64Array | None:
    try:
        matrix, _ = finder(np.ascontiguousarray(x1), np.ascontiguousarray(x2), params=_usac(config))
    except cv2.error:
        return None  # too degenerate for the solver: the caller reports that there is no model
    if matrix is None or matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        return None  # the 7-point method may stack three solutions: none of them is chosen
    return np.asarray(matrix, np.float64)


def _usac(config: EstimatorConfig) -> cv2.UsacParams:
    params = cv2.UsacParams()
    params.threshold = config.threshold
    params.confidence = config.confidence
    params.maxIterations = config.max_iterations
    params.randomGeneratorState = config.seed
    params.isParallel = False
    params.sampler = cv2.SAMPLING_UNIFORM
    params.score = cv2.SCORE_METHOD_MAGSAC
    params.loMethod = cv2.LOCAL_OPTIM_SIGMA
    params.loSampleSize = 50
    params.loIterations = 10
    return params


def _spread(points: Float64Array) -> float:
    """Standard deviation across the main direction of a point set, pixels: 0 on a line."""
    centred = points - points.mean(axis=0)
    return float(np.linalg.svd(centred, compute_uv=False)[-1] / np.sqrt(len(points)))
