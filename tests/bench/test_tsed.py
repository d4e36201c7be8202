"""TSED as a metric of the bench: values, curve, nulls, warnings, other frame sizes, JSON."""

from __future__ import annotations

import json
from functools import cache
from typing import Any

import numpy as np
import pytest

from bench.adapters.adapter import MethodOutput
from bench.datasets.case import SceneCase
from bench.metrics import METRICS
from bench.metrics.metric import MetricInput, Score
from bench.metrics.tsed import NO_POWER, Tsed
from bench.metrics.tsed_config import TsedConfig
from bench.metrics.tsed_pair import PairScore
from bench.metrics.tsed_pooled import pool_fractions
from bench.metrics.tsed_sequence import SequenceScore
from bench.trajectories.trajectory import Trajectory
from orca.camera import Camera
from orca.errors import BadInput
from tests.bench.tsed_scenes import Image, camera_of, plane_homography, pose, rotation, texture, warp

SIZE = 256
NORMAL = np.array([0.3, -0.2, 1.0]) / np.linalg.norm([0.3, -0.2, 1.0])
POSES = [pose(rotation("y", 4 * k) @ rotation("x", -2 * k), (-0.3 * k, 0.1 * k * k, 0.05 * k)) for k in range(4)]


@cache
def frames(size: int = SIZE) -> Image:
    image = texture()
    source = camera_of(image)
    targets = [camera_of(image, p[:3, :3], p[:3, 3]).resized(size, size) for p in POSES]
    return np.stack([warp(image, plane_homography(source, target, NORMAL, 4.0), size) for target in targets])


def case(poses: list[np.ndarray] | None = None) -> SceneCase:
    """The scene at 512x512, whatever the frames' size."""
    image = texture()
    camera = camera_of(image)
    here = np.stack(poses or POSES)
    trajectory = Trajectory("test", camera.K, here, camera.width, camera.height)
    depth = np.full(image.shape[:2], 4.0, np.float32)
    return SceneCase("d", "s", image, camera, depth, "exact", True, "exact", trajectory, tuple(range(len(here))))


def scores(images: Image, poses: list[np.ndarray] | None = None, config: TsedConfig | None = None) -> dict[str, Score]:
    return Tsed(config).compute(MetricInput(case(poses), MethodOutput(images)))


@cache
def good() -> dict[str, Score]:
    return scores(frames())


def test_registered_under_both_ids() -> None:
    assert METRICS.get("tsed") is METRICS.get("tsed_median_sed") is Tsed
    assert [spec.id for spec in Tsed().specs(None)] == ["tsed", "tsed_median_sed"] == list(good())
    assert "known cameras" in Tsed().specs(None)[0].variant


def test_values_of_a_consistent_sequence() -> None:
    fraction, median = good()["tsed"], good()["tsed_median_sed"]
    assert (fraction.value, fraction.n, fraction.per_frame) == (1.0, 3, (1.0, 1.0, 1.0))
    medians = [pair["median"] for pair in fraction.detail["pairs"]]
    assert median.value == np.median(medians) < 0.25
    assert median.per_frame == tuple(medians)
    assert fraction.detail["warning"] is None
    assert fraction.detail["median_flow"] > 5
    assert median.detail["at_width_256"] == median.value


def test_detail_is_json_and_complete() -> None:
    for score in good().values():
        json.dumps(score.detail, allow_nan=False)
    detail = good()["tsed"].detail
    assert {"frozen_null", "shifted_camera_null", "config_sha256", "opencv", "width", "height"} <= set(detail)
    assert detail["config_sha256"] == TsedConfig().sha256
    assert detail["pairs"][1]["frames"] == [1, 2]
    assert {"n", "median", "ok", "reason", "model", "flow"} <= set(detail["pairs"][0])
    grid = {(row["t_error"], row["t_matches"], row["t_error_width"]) for row in detail["curve"]}
    assert grid == {(t, n, SIZE) for t in (0.5, 1.0, 2.0, 4.0) for n in (10, 15)}


def test_frames_of_another_size_get_resized_cameras() -> None:
    other = scores(frames(384))
    assert other["tsed"].value == 1.0
    assert other["tsed_median_sed"].value == pytest.approx(good()["tsed_median_sed"].value, abs=0.15)
    widths = {row["t_error_width"] for row in other["tsed"].detail["curve"]}
    assert widths == {384, 256}


def test_wrong_cameras_fail() -> None:
    result = scores(frames(), [np.linalg.inv(p) for p in POSES])
    assert result["tsed"].value == 0.0
    assert {pair["reason"] for pair in result["tsed"].detail["pairs"]} == {"sed"}
    assert result["tsed_median_sed"].value is not None
    assert result["tsed_median_sed"].value > 4


def test_a_frozen_video_is_told_from_a_good_one_only_by_the_nulls() -> None:
    small = [pose(t=(-0.002 * k, 0, 0)) for k in range(4)]
    result = scores(np.stack([frames()[0]] * 4), small)["tsed"]
    assert result.value == 1.0
    assert result.detail["frozen_null"] == 1.0
    assert result.detail["powerless_against"] == ["frozen", "shifted_camera"]
    assert result.detail["warning"].startswith(NO_POWER)


def test_black_frames_have_a_fraction_but_no_distance() -> None:
    result = scores(np.zeros((4, SIZE, SIZE, 3), np.uint8))
    assert result["tsed"].value == 0.0
    assert {pair["reason"] for pair in result["tsed"].detail["pairs"]} == {"few_matches"}
    assert result["tsed_median_sed"].value is None
    assert result["tsed_median_sed"].reason
    for score in result.values():
        json.dumps([score.detail, score.per_frame], allow_nan=False)


def test_estimated_geometry_has_its_own_ids() -> None:
    result = scores(frames(), [np.linalg.inv(p) for p in POSES], TsedConfig(mode="estimated"))
    assert list(result) == ["epipolar_self_consistency", "epipolar_self_consistency_median_sed"]
    fraction = result["epipolar_self_consistency"]
    assert fraction.value == 1.0  # wrong cameras do not matter to it
    assert {pair["model"] for pair in fraction.detail["pairs"]} == {"H"}
    assert fraction.detail["shifted_camera_null"] is None
    assert fraction.detail["powerless_against"] == ["frozen"]
    json.dumps(fraction.detail, allow_nan=False)


def test_prefilter_is_marked() -> None:
    config = TsedConfig(ransac_prefilter=True)
    result = scores(frames()[:2], POSES[:2], config)["tsed"]
    assert result.detail["ransac_prefilter"] is True
    assert "RANSAC" in Tsed(config).specs(None)[0].variant
    assert result.n == 1


def test_excluded_pairs_are_not_counted() -> None:
    turning = [pose(rotation("y", 3 * k)) for k in range(4)]
    result = scores(frames(), turning, TsedConfig(zero_baseline="exclude"))
    assert (result["tsed"].value, result["tsed"].n, result["tsed"].per_frame) == (None, 0, (None, None, None))
    assert result["tsed"].reason
    assert result["tsed_median_sed"].reason
    json.dumps(result["tsed"].detail, allow_nan=False)


def test_one_frame_has_no_pair() -> None:
    result = scores(frames()[:1], POSES[:1])
    assert all(score.value is None and score.reason for score in result.values())
    assert list(result) == ["tsed", "tsed_median_sed"]


@pytest.mark.parametrize(
    "images",
    [
        np.zeros((3, 8, 8, 3), np.uint8),
        np.zeros((4, 8, 8), np.uint8),
        np.zeros((4, 8, 8, 3), np.float32),
        np.zeros((1, 8, 8, 3), np.uint8),
    ],
)
def test_frames_that_do_not_fit_are_refused(images: np.ndarray) -> None:
    with pytest.raises(BadInput, match="frames"):
        scores(images)


@pytest.mark.parametrize(
    "wrong",
    [
        {"mode": "guessed"},
        {"zero_baseline": "skip"},
        {"t_error": 0.0},
        {"t_matches": 0},
        {"curve_errors": (1.0, -1.0)},
        {"t_error_width": 0},
        {"mode": "estimated", "ransac_prefilter": True},
    ],
)
def test_impossible_settings_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(BadInput):
        TsedConfig(**wrong)


def test_settings_have_a_hash_that_follows_them() -> None:
    assert TsedConfig().sha256 == TsedConfig().sha256 != TsedConfig(t_error=1.0).sha256
    assert Tsed().specs(None)[0].version != Tsed(TsedConfig(t_error=1.0)).specs(None)[0].version


def sequence(medians: list[float], width: int = 512, **config: Any) -> SequenceScore:
    pairs = tuple(PairScore(20, median, "F") for median in medians)
    return SequenceScore(TsedConfig(**config), width, pairs, (3.0,) * len(pairs), pairs, pairs)


def test_normalised_thresholds_scale_with_the_width() -> None:
    # 3 px at 512 is 1.5 px at 256.
    score = sequence([3.0, 3.0, 5.0])
    rows = {(row["t_error"], row["t_error_width"]): row["tsed"] for row in score.curve() if row["t_matches"] == 10}
    assert (rows[2.0, 512], rows[2.0, 256], rows[4.0, 256]) == (0.0, 2 / 3, 1.0)
    assert score.tsed() == 0.0
    assert sequence([3.0, 3.0, 5.0], t_error_width=256).tsed() == 2 / 3


def test_the_median_over_pairs_counts_a_pair_without_matches_as_far() -> None:
    assert sequence([0.1, 0.2, float("inf")]).median_sed == 0.2
    assert sequence([0.1, float("inf"), float("inf")]).median_sed is None


def test_power_is_judged_within_five_hundredths() -> None:
    def against(frozen_ok: int) -> tuple[str, ...]:
        pairs = tuple(PairScore(20, 0.1, "F") for _ in range(20))
        frozen = tuple(PairScore(20, 0.1 if k < frozen_ok else 9.0, "F") for k in range(20))
        return SequenceScore(TsedConfig(), 512, pairs, (3.0,) * 20, frozen, ()).powerless_against()

    assert against(20) == ("frozen",)
    assert against(19) == ("frozen",)
    assert against(18) == ()


def test_pooled_fraction_and_mean_over_scenes() -> None:
    pooled = pool_fractions([(49, 49), (10, 20), (0, 0)])
    assert (pooled.consistent, pooled.pairs, pooled.scenes) == (59, 69, 2)
    assert pooled.pooled == pytest.approx(59 / 69)
    assert pooled.mean == 0.75
    assert 0 < pooled.low < pooled.pooled < pooled.high < 1
    # The paper's count of 405 of 490 pairs: Wilson 95 %, worked by hand.
    paper = pool_fractions([(405, 490)])
    assert (round(paper.pooled, 4), round(paper.low, 4), round(paper.high, 4)) == (0.8265, 0.7905, 0.8575)


@pytest.mark.parametrize("counts", [[], [(0, 0)], [(5, 4)], [(-1, 4)]])
def test_impossible_counts_are_refused(counts: list[tuple[int, int]]) -> None:
    with pytest.raises(BadInput, match="counts"):
        pool_fractions(counts)


def test_cameras_carry_their_own_intrinsics() -> None:
    # A second lens: judged with the first one's K for both views the pair fails.
    image = texture()
    first = camera_of(image)
    K = np.array([[620.0, 0, 230], [0, 600, 290], [0, 0, 1]])
    second = Camera(K, POSES[1], first.width, first.height)
    pair = np.stack([image, warp(image, plane_homography(first, second, NORMAL, 4.0))])
    trajectory = Trajectory("two", np.stack([first.K, K]), np.stack(POSES[:2]), first.width, first.height)
    base = case()
    scene = SceneCase("d", "s", image, first, base.depth, "exact", True, "exact", trajectory, (0, 1))
    assert Tsed().compute(MetricInput(scene, MethodOutput(pair)))["tsed"].value == 1.0
    same = Trajectory("one", first.K, np.stack(POSES[:2]), first.width, first.height)
    scene = SceneCase("d", "s", image, first, base.depth, "exact", True, "exact", same, (0, 1))
    assert Tsed().compute(MetricInput(scene, MethodOutput(pair)))["tsed"].value == 0.0
