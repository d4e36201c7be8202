"""Affine depth alignment and the blend at the boundary."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orca.errors import BadInput, OrcaError
from orca.repair.align import AffineFit, AlignmentFailed, blend_boundary, robust_affine


def samples(n: int, a: float, b: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    pred = np.random.default_rng(seed).uniform(1.0, 5.0, n).astype(np.float32)
    return pred, (a * pred + b).astype(np.float32)


@settings(max_examples=25, deadline=None)
@given(a=st.floats(0.05, 20.0), b=st.floats(0.0, 10.0), seed=st.integers(0, 99))
def test_exact_data_give_the_exact_line(a: float, b: float, seed: int) -> None:
    fit = robust_affine(*samples(200, a, b, seed))
    assert fit.a == pytest.approx(a, rel=1e-4)
    assert fit.b == pytest.approx(b, abs=1e-4 * (a + b))
    assert fit.inlier_share == 1.0


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("share", [0.1, 0.3, 0.45])
def test_one_sided_outliers_do_not_move_the_line(share: float, seed: int) -> None:
    """A foreground object inside the crop: constant, near, and at one end of the prediction."""
    pred, target = samples(1000, 2.0, 0.5, seed)
    target *= 1.0 + np.random.default_rng(seed).normal(0, 0.005, 1000).astype(np.float32)
    worst = np.argsort(pred)[: int(share * 1000)]
    target[worst] = 30.0
    fit = robust_affine(pred, target)
    assert fit.a == pytest.approx(2.0, rel=0.02)
    assert fit.b == pytest.approx(0.5, abs=0.1)
    assert fit.inlier_share == pytest.approx(1.0 - share, abs=0.02)
    plain = np.polyfit(pred, target, 1)
    assert abs(plain[0] - 2.0) > 0.5  # what least squares would have said


def test_the_fit_is_deterministic_and_ignores_unusable_samples() -> None:
    pred, target = samples(500, 1.5, 1.0)
    target[:100] = np.random.default_rng(3).uniform(1, 20, 100)
    clean = robust_affine(pred, target)
    assert robust_affine(pred, target) == clean
    broken = np.array([np.nan, np.inf, 1.0, 1.0], np.float32)
    hopeless = np.array([1.0, 1.0, 0.0, np.nan], np.float32)
    assert robust_affine(np.concatenate([pred, broken]), np.concatenate([target, hopeless])) == clean


def test_apply() -> None:
    aligned = AffineFit(2.0, 0.5, 1.0).apply(np.array([[1.0, 2.0]], np.float32))
    assert aligned.dtype == np.float32
    assert aligned.tolist() == [[2.5, 4.5]]


def test_failures_are_typed_and_say_why() -> None:
    pred, target = samples(200, 1.0, 1.0)
    noise = np.random.default_rng(7).uniform(0.1, 100, 200).astype(np.float32)
    cases = {
        "usable depth samples": (pred[:31], target[:31]),
        "constant": (np.ones(200, np.float32), target),
        "inliers": (pred, noise),
        "depth scale": (pred, (8.0 - pred).astype(np.float32)),
    }
    for words, (p, t) in cases.items():
        with pytest.raises(AlignmentFailed, match=words) as failure:
            robust_affine(p, t)
        assert isinstance(failure.value, OrcaError)
    with pytest.raises(BadInput):
        robust_affine(pred, target[:-1])


def test_blend_is_the_background_outside_and_the_prediction_deep_inside() -> None:
    hole = np.zeros((40, 60), bool)
    hole[10:40, 10:50] = True  # touches the lower border
    background, aligned = np.full(hole.shape, 4.0, np.float32), np.full(hole.shape, 2.0, np.float32)
    aligned[~hole] = np.nan
    depth = blend_boundary(aligned, background, hole, 8)
    assert (depth[~hole] == 4.0).all()
    assert (depth[20:40, 20:40] == 2.0).all()  # the image border is no boundary of the hole
    profile = depth[10:20, 30]
    assert (np.diff(profile) <= 0).all()
    assert 3.8 < profile[0] < 4.0
    assert depth[13, 30] == pytest.approx(3.0, abs=0.05)  # half way: both alike


def test_blend_without_any_boundary_is_the_prediction() -> None:
    ones = np.ones((5, 7), np.float32)
    assert np.array_equal(blend_boundary(3 * ones, np.nan * ones, ones.astype(bool), 4), 3 * ones)
    with pytest.raises(BadInput):
        blend_boundary(ones, ones[:-1], ones.astype(bool), 4)
