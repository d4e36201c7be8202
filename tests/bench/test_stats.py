"""Means and intervals, against hand-worked and published values."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binomtest

from bench.stats import Mean, bootstrap_interval, mean_of_present, wilson_interval
from orca.errors import BadInput


def test_a_mean_says_what_it_is_a_mean_of() -> None:
    assert mean_of_present([1.0, None, 3.0]) == Mean(2.0, 2, 3)
    assert not mean_of_present([1.0, None]).complete
    assert mean_of_present([1.0, 2.0]).complete
    assert mean_of_present([None, None]) == Mean(None, 0, 2)
    assert not mean_of_present([]).complete


@pytest.mark.parametrize(("successes", "trials"), [(0, 10), (10, 10), (405, 490), (145, 147), (1, 1)])
def test_wilson_equals_scipy(successes: int, trials: int) -> None:
    want = binomtest(successes, trials).proportion_ci(0.95, method="wilson")
    assert wilson_interval(successes, trials) == pytest.approx((want.low, want.high), abs=1e-12)


def test_wilson_by_hand() -> None:
    # p = 1/2, n = 4, z = 1.959964: centre 1/2, half = z sqrt(1/16 + z^2/64) / (1 + z^2/4) = 0.349961
    assert wilson_interval(2, 4) == pytest.approx((0.150039, 0.849961), abs=1e-6)


@pytest.mark.parametrize(("successes", "trials"), [(1, 0), (5, 4), (-1, 4)])
def test_wilson_refuses_impossible_counts(successes: int, trials: int) -> None:
    with pytest.raises(BadInput, match="trials"):
        wilson_interval(successes, trials)


def test_bootstrap_is_repeatable_and_covers_as_it_should() -> None:
    rng = np.random.default_rng(1)
    values = list(rng.normal(10, 2, 40))
    assert bootstrap_interval(values) == bootstrap_interval(values)
    assert bootstrap_interval(values) != bootstrap_interval(values, seed=1)
    low, high = bootstrap_interval(values)
    half = 1.96 * np.std(values) / np.sqrt(len(values))
    assert (low, high) == pytest.approx((np.mean(values) - half, np.mean(values) + half), abs=0.1)


def test_bootstrap_of_equal_values_is_a_point() -> None:
    assert bootstrap_interval([3.0, 3.0, 3.0]) == (3.0, 3.0)


@pytest.mark.parametrize("values", [[], [1.0, float("nan")], [float("inf")]])
def test_bootstrap_refuses_what_has_no_mean(values: list[float]) -> None:
    with pytest.raises(BadInput, match="finite"):
        bootstrap_interval(values)


@pytest.mark.parametrize("confidence", [0.0, 1.0, 95.0])
def test_a_confidence_is_a_probability(confidence: float) -> None:
    with pytest.raises(BadInput, match="confidence"):
        wilson_interval(1, 2, confidence)
    with pytest.raises(BadInput, match="confidence"):
        bootstrap_interval([1.0], confidence)
