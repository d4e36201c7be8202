"""Early stopping: histories worked by hand with the paper's gain of 0.03 dB and patience of 4."""

from __future__ import annotations

import pytest

from orca.stages.early_stopping import EarlyStopping


def stops_at(values: list[float], smoothing: float = 1.0, arm_after: int = 0) -> int | None:
    """Step of the stop, evaluations coming every 1,000 steps; None if there is none."""
    stopping = EarlyStopping(min_gain_db=0.03, patience=4, smoothing=smoothing, arm_after=arm_after)
    for i, value in enumerate(values, start=1):
        if stopping.update(1000 * i, value):
            return 1000 * i
    return None


def test_flat_history_stops_after_four_evaluations_without_gain() -> None:
    assert stops_at([30.0] * 4) is None
    assert stops_at([30.0] * 9) == 5000


def test_steady_gains_never_stop() -> None:
    assert stops_at([30 + 0.031 * i for i in range(100)]) is None


def test_gains_below_the_minimum_count_against_the_best_and_add_up() -> None:
    # 0.02 at a time: 30.00, .02 (waited 1), .04 (gain of .04 over the best: counts), and so on.
    assert stops_at([30 + 0.02 * i for i in range(40)]) is None
    # 0.005 at a time: after 30.000 come four evaluations below 30.030.
    assert stops_at([30 + 0.005 * i for i in range(40)]) == 5000


def test_one_gain_resets_the_patience() -> None:
    #          best  1     2     3     best  1     2     3     4
    assert stops_at([30.0, 30.0, 30.0, 30.0, 30.5, 30.5, 30.5, 30.5, 30.5]) == 9000


def test_a_loss_waits_like_a_standstill_and_the_best_stays() -> None:
    #          best  1     2     3 (better than before, not than the best)  4
    assert stops_at([30.0, 29.0, 29.5, 29.9, 30.02]) == 5000


def test_not_armed_before_its_time() -> None:
    # Flat from the start, armed after 10,000: evaluations at 11,000 to 14,000 are the four that count.
    assert stops_at([30.0] * 10, arm_after=10_000) is None
    assert stops_at([30.0] * 30, arm_after=10_000) == 14_000


def test_smoothing_is_a_running_mean() -> None:
    stopping = EarlyStopping(min_gain_db=0.03, patience=4, smoothing=0.5)
    for step, value in enumerate([20.0, 30.0, 30.0]):
        stopping.update(step, value)
    assert stopping.history == [(0, 20.0, 20.0), (1, 30.0, 25.0), (2, 30.0, 27.5)]


def test_smoothing_sees_through_noise() -> None:
    # Every second evaluation sets no record, and yet the mean climbs by 0.1 every two of them.
    noisy = [30 + 0.05 * i + (0.2 if i % 2 else 0) for i in range(30)]
    assert stops_at(noisy, smoothing=0.5) is None


def test_a_diverged_run_stops() -> None:
    assert stops_at([30.0, float("nan"), float("nan"), float("nan"), float("nan")]) == 5000


@pytest.mark.parametrize("patience", [1, 3])
def test_patience(patience: int) -> None:
    stopping = EarlyStopping(0.03, patience, 1.0)
    assert [stopping.update(i, 30.0) for i in range(1, patience + 2)] == [False] * patience + [True]
