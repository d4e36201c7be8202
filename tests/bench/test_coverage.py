"""Hole fraction: hand values and the cases without one."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from bench.adapters.adapter import MethodOutput
from bench.metrics.coverage import HoleFraction
from bench.metrics.metric import MetricInput, Score
from orca.errors import BadInput
from tests.bench.small_cases import make_case, noise_image, plane

CASE = make_case(noise_image(4, 5), plane(4, 5), [np.eye(4)])


def score(coverage: NDArray[np.float32] | None, frames: int) -> Score:
    output = MethodOutput(np.zeros((frames, 4, 5, 3), np.uint8), coverage=coverage)
    return HoleFraction().compute(MetricInput(CASE, output))["hole_fraction"]


def test_share_of_pixels_below_one_half() -> None:
    coverage = np.ones((2, 4, 5), np.float32)
    coverage[0, 0, :] = 0.0  # 5 of 20
    coverage[1, 1, 1] = 0.499  # 1 of 20
    coverage[1, 2, 2] = 0.5  # covered
    found = score(coverage, 2)
    assert found.value == pytest.approx((5 / 20 + 1 / 20) / 2)
    assert found.per_frame == pytest.approx((0.25, 0.05))
    assert found.n == 2


def test_nan_is_a_hole_and_one_frame_is_enough() -> None:
    coverage = np.full((1, 4, 5), np.nan, np.float32)
    assert score(coverage, 1).value == 1.0
    assert score(np.ones((1, 4, 5), np.float32), 1).value == 0.0


def test_no_coverage_or_no_frames_give_a_reason() -> None:
    assert score(None, 1).reason == "decoded video carries no coverage"
    assert score(np.zeros((0, 4, 5), np.float32), 0).reason == "no frames"


def test_wrong_shapes_are_refused() -> None:
    with pytest.raises(BadInput, match="for 2 frames"):
        score(np.ones((1, 4, 5), np.float32), 2)
    with pytest.raises(BadInput, match=r"\[n, H, W\]"):
        score(np.ones((4, 5), np.float32), 4)
