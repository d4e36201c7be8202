"""The verdict on one pair from exact, noisy and broken matches: known cameras."""

from __future__ import annotations

import json

import numpy as np
import pytest

from bench.metrics.tsed_config import TsedConfig
from bench.metrics.tsed_pair import PairMatches, PairScore, judge_known, median_distance
from orca.camera import Camera
from tests.bench.tsed_scenes import SIZE, cloud, matches_of, pose, rotation, view

LATERAL = view(t=(0.4, 0, 0))
TURN = view(rotation("y", 6) @ rotation("x", 2), (0.4, 0.1, -0.2))


def judge(first: Camera, second: Camera, x1: np.ndarray, x2: np.ndarray, config: TsedConfig | None = None) -> PairScore:
    return judge_known(PairMatches(x1, x2), first, second, 1.0, config)


def passes(score: PairScore) -> bool:
    return score.ok(2.0, 10)


@pytest.mark.parametrize("sigma", [0.5, 1.0, 3.0])
def test_noise_gives_its_expected_median(sigma: float) -> None:
    # Independent noise in both views, parallel lines: |N(0, 2 sigma^2)| has median 0.6745 sqrt(2) sigma = 0.954 sigma.
    rng = np.random.default_rng(0)
    x1, x2 = matches_of(view(), LATERAL, cloud(0, 20_000))
    noisy = judge(view(), LATERAL, x1 + rng.normal(0, sigma, x1.shape), x2 + rng.normal(0, sigma, x2.shape))
    assert noisy.median == pytest.approx(0.954 * sigma, rel=0.03)


@pytest.mark.parametrize(("sigma", "expected"), [(2.03, True), (2.17, False)])
def test_two_pixels_are_crossed_at_noise_of_2_1(sigma: float, expected: bool) -> None:
    rng = np.random.default_rng(0)
    x1, x2 = matches_of(view(), LATERAL, cloud(0, 20_000))
    noisy = judge(view(), LATERAL, x1 + rng.normal(0, sigma, x1.shape), x2 + rng.normal(0, sigma, x2.shape))
    assert passes(noisy) is expected


@pytest.mark.parametrize(("degrees", "expected"), [(0.1, True), (0.2, True), (0.3, False), (0.5, False), (2.0, False)])
def test_pitch_error_of_the_second_camera(degrees: float, expected: bool) -> None:
    x1, x2 = matches_of(view(), LATERAL)
    wrong = view(rotation("x", degrees), rotation("x", degrees) @ LATERAL.translation)
    score = judge(view(), wrong, x1, x2)
    assert passes(score) is expected
    assert score.reason(2.0, 10) == (None if expected else "sed")


def test_distance_grows_with_the_pose_error() -> None:
    rng = np.random.default_rng(1)
    first = view()
    seconds = [view(rotation("y", rng.uniform(-5, 5)), rng.uniform(-0.5, 0.5, 3)) for _ in range(12)]
    means, fractions = [], []
    for error in np.linspace(0, 5, 11):
        scores = []
        for k, second in enumerate(seconds):
            x1, x2 = matches_of(first, second, cloud(k))
            scores.append(
                judge(first, Camera(second.K, pose(rotation("x", error)) @ second.world_to_camera, SIZE, SIZE), x1, x2)
            )
        means.append(np.mean([score.median for score in scores]))
        fractions.append(np.mean([passes(score) for score in scores]))
    assert np.all(np.diff(means) > 0)
    assert fractions[0] == 1.0
    assert fractions[-1] == 0.0
    assert np.all(np.diff(fractions) <= 0)


@pytest.mark.parametrize(("outliers", "expected"), [(0.45, True), (0.55, False)])
def test_the_median_takes_up_to_half_outliers(outliers: float, expected: bool) -> None:
    rng = np.random.default_rng(2)
    x1, x2 = matches_of(view(), LATERAL)
    wrong = int(outliers * len(x1))
    x2[:wrong, 1] += rng.uniform(20, 200, wrong) * rng.choice([-1, 1], wrong)
    assert passes(judge(view(), LATERAL, x1, x2)) is expected


@pytest.mark.parametrize(("n", "expected"), [(9, False), (10, True)])
def test_ten_matches_are_enough_and_nine_are_not(n: int, expected: bool) -> None:
    x1, x2 = matches_of(view(), LATERAL)
    score = judge(view(), LATERAL, x1[:n], x2[:n])
    assert passes(score) is expected
    assert score.reason(2.0, 10) == (None if expected else "few_matches")
    assert not score.ok(2.0, 15)


@pytest.mark.parametrize(("offset", "expected"), [(2.0, False), (2.0 - 1e-6, True)])
def test_the_threshold_is_strict(offset: float, expected: bool) -> None:
    # A focal length that is a power of two keeps every number of this case exact.
    K = np.array([[256.0, 0, 256], [0, 256, 256], [0, 0, 1]])
    first, second = Camera(K, np.eye(4), SIZE, SIZE), Camera(K, pose(t=(0.5, 0, 0)), SIZE, SIZE)
    x1 = np.stack([np.arange(12.0) * 16, np.arange(12.0) * 32], axis=1)
    score = judge(first, second, x1, x1 + np.array([8.0, offset]))
    assert score.median == (offset if offset == 2.0 else pytest.approx(offset, abs=1e-9))
    assert passes(score) is expected


def test_even_counts_average_the_middle_two() -> None:
    assert median_distance(np.array([1.0, 2.0, 4.0, 100.0])) == 3.0
    assert median_distance(np.array([1.0, 2.0, 100.0])) == 2.0
    assert median_distance(np.array([0.0, 0.0, np.inf])) == 0.0
    assert median_distance(np.array([0.0, np.inf])) == np.inf
    assert median_distance(np.zeros(0)) == np.inf


def test_one_match_on_the_epipole_does_not_poison_the_pair() -> None:
    second = view(t=(0, 0, -0.5))
    x1, x2 = matches_of(view(), second)
    centre = np.full((1, 2), SIZE / 2)
    score = judge(view(), second, np.vstack([x1, centre]), np.vstack([x2, centre]))
    assert passes(score)
    assert score.median < 1e-8


def degenerate() -> dict[str, np.ndarray]:
    line = np.linspace(10, 400, 30)
    return {
        "empty": np.zeros((0, 2)),
        "five": cloud(3, 5)[:, :2] * 100 + 256,
        "equal": np.full((30, 2), 100.0),
        "collinear": np.stack([line, 2 * line], axis=1),
    }


@pytest.mark.parametrize("name", degenerate())
@pytest.mark.parametrize("policy", ["homography", "reference", "exclude"])
@pytest.mark.parametrize("second", [LATERAL, TURN, view()], ids=["lateral", "turn", "same"])
def test_degenerate_matches_never_raise(name: str, policy: str, second: Camera) -> None:
    points = degenerate()[name]
    score = judge(view(), second, points, points, TsedConfig(zero_baseline=policy))  # type: ignore[arg-type]
    assert score.n == len(points)
    assert not np.isnan(score.median)
    assert (score.reason(2.0, 10) == "few_matches") is (len(points) < 10)
    json.dumps(score.to_json(2.0, 10), allow_nan=False)


def test_zero_baseline_policies() -> None:
    first, second = view(), view(rotation("y", 5))
    x1, x2 = matches_of(first, second)
    by_homography = judge(first, second, x1, x2)
    assert passes(by_homography)
    assert by_homography.model == "H"
    assert by_homography.median < 1e-9
    reference = judge(first, second, x1, x2, TsedConfig(zero_baseline="reference"))
    assert not passes(reference)
    assert reference.reason(2.0, 10) == "zero_baseline"
    assert not reference.excluded
    assert judge(first, second, x1, x2, TsedConfig(zero_baseline="exclude")).excluded
    wrong = judge(second, first, x1, x2)
    assert not passes(wrong)
    assert wrong.reason(2.0, 10) == "sed"


def test_an_excluded_pair_is_never_consistent() -> None:
    assert PairScore(20, 0.1, "F").ok(2.0, 10)
    assert not PairScore(20, 0.1, "F", excluded=True).ok(2.0, 10)


def test_frozen_pair_needs_a_rotation_to_be_seen() -> None:
    x1, x2 = matches_of(view(), TURN)
    frozen = PairMatches(x1, x2).frozen()
    assert judge_known(frozen, view(), TURN, 1.0).median > 2.0
    assert judge_known(frozen, view(), LATERAL, 1.0).median < 1e-8


def test_flow_is_the_median_displacement() -> None:
    x1 = np.zeros((3, 2))
    assert PairMatches(x1, x1 + np.array([[3, 4], [6, 8], [0, 1]])).flow == 5.0
    assert PairMatches(x1[:0], x1[:0]).flow is None


def test_json_of_an_infinite_median() -> None:
    assert PairScore(12, float("inf"), "F").to_json(2.0, 10)["median"] == "inf"
    assert PairScore(0, float("inf"), "F").to_json(2.0, 10)["median"] is None
