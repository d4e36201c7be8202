"""TSED from pixels: real textures warped by homographies whose cameras are known exactly."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

from bench.metrics.epipolar import fundamental_matrix, infinite_homography, symmetric_epipolar_distance
from bench.metrics.matching import match_descriptors
from bench.metrics.sift import detect
from bench.metrics.tsed_config import TsedConfig
from bench.metrics.tsed_pair import PairMatches, PairScore, judge_estimated, judge_known
from bench.metrics.tsed_sequence import SequenceScore, match_consecutive, score_sequence
from orca.camera import Camera
from tests.bench.tsed_scenes import Image, camera_of, plane_homography, pose, rotation, texture, warp

NORMAL = np.array([0.3, -0.2, 1.0]) / np.linalg.norm([0.3, -0.2, 1.0])
DISTANCE = 4.0


@dataclass(frozen=True, eq=False)
class Pair:
    """Two views of a textured plane and their matches."""

    first: Camera
    second: Camera
    images: tuple[Image, Image]
    matches: PairMatches


def matches_of(first: Image, second: Image) -> PairMatches:
    a, b = detect(first), detect(second)
    i, j = match_descriptors(a.descriptors, b.descriptors)
    return PairMatches(a.points[i], b.points[j])


@cache
def planar(name: str = "astronaut") -> Pair:
    """A plane seen before and after a turn of 8 degrees and a step to the side."""
    image = texture(name)
    R = rotation("y", 7) @ rotation("x", -3) @ rotation("z", 2)
    first, second = camera_of(image), camera_of(image, R, (-0.45, 0.1, 0.15))
    moved = warp(image, plane_homography(first, second, NORMAL, DISTANCE))
    return Pair(first, second, (image, moved), matches_of(image, moved))


def judge(pair: Pair, first: Camera | None = None, second: Camera | None = None) -> PairScore:
    return judge_known(pair.matches, first or pair.first, second or pair.second, 1.0)


@pytest.mark.parametrize("name", ["astronaut", "coffee"])
def test_a_plane_in_motion_passes(name: str) -> None:
    pair = planar(name)
    score = judge(pair)
    F = fundamental_matrix(pair.first, pair.second)
    distance = symmetric_epipolar_distance(F, pair.matches.x1, pair.matches.x2)
    assert score.ok(2.0, 10)
    assert score.model == "F"
    assert score.n >= 500
    assert score.median < 0.15
    assert np.mean(distance < 2) > 0.97


def test_a_plane_is_a_homography_to_the_estimator() -> None:
    score = judge_estimated(planar().matches)
    assert score.model == "H"
    assert score.ok(2.0, 10)


def wrong_cameras(pair: Pair) -> dict[str, tuple[Camera, Camera]]:
    second = pair.second

    def with_pose(world_to_camera: np.ndarray) -> Camera:
        return Camera(second.K, world_to_camera, second.width, second.height)

    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    return {
        "swapped order": (second, pair.first),
        "R transposed": (pair.first, with_pose(pose(second.rotation.T, second.translation))),
        "camera-to-world": (pair.first, with_pose(np.linalg.inv(second.world_to_camera))),
        "OpenGL axes": (pair.first, with_pose(flip @ second.world_to_camera @ flip)),
    }


@pytest.mark.parametrize("name", ["swapped order", "R transposed", "camera-to-world", "OpenGL axes"])
def test_wrong_conventions_fail_by_far(name: str) -> None:
    first, second = wrong_cameras(planar())[name]
    score = judge(planar(), first, second)
    assert score.reason(2.0, 10) == "sed"
    assert score.median > 4


def test_a_rotation_passes_through_the_homography() -> None:
    image = texture()
    first, second = camera_of(image), camera_of(image, rotation("y", 5))
    matches = matches_of(image, warp(image, infinite_homography(first, second)))
    score = judge_known(matches, first, second, 1.0)
    assert (score.model, score.ok(2.0, 10)) == ("H", True)
    assert score.median < 0.2
    assert not judge_known(matches, first, second, 1.0, TsedConfig(zero_baseline="reference")).ok(2.0, 10)
    assert not judge_known(matches, second, first, 1.0).ok(2.0, 10)


def pictures() -> dict[str, tuple[Image, Image]]:
    rng = np.random.default_rng(0)
    grey = np.full((256, 256, 3), 127, np.uint8)
    return {
        "constant": (grey, grey),
        "noise": tuple(rng.integers(0, 256, (2, 256, 256, 3), np.uint8)),  # type: ignore[dict-item]
        "unrelated": (texture("astronaut")[:256, :256], texture("coffee")[:256, :256]),
        "constant and photograph": (grey, texture()[:256, :256]),
    }


@pytest.mark.parametrize("name", ["constant", "noise", "unrelated", "constant and photograph"])
def test_images_without_common_content_have_few_matches(name: str) -> None:
    first, second = pictures()[name]
    matches = matches_of(first, second)
    score = judge_known(matches, camera_of(first), camera_of(second, t=(0.4, 0, 0)), 1.0)
    assert score.reason(2.0, 10) == "few_matches"


@pytest.mark.parametrize(("share", "expected"), [(0.1, True), (0.3, True), (0.85, False)])
def test_holes_that_stay_on_the_screen(share: float, expected: bool) -> None:
    pair = planar()
    size = pair.images[0].shape[0]
    cells = np.random.default_rng(3).permutation((size // 32) ** 2) < share * (size // 32) ** 2
    hole = np.kron(cells.reshape(size // 32, -1), np.ones((32, 32), bool)).astype(bool)
    first, second = (np.where(hole[..., None], np.uint8(0), image) for image in pair.images)
    score = judge_known(matches_of(first, second), pair.first, pair.second, 1.0)
    assert score.ok(2.0, 10) is expected


def test_exact_tiles_cannot_be_matched() -> None:
    tiles = np.tile(texture()[200:264, 200:264], (6, 6, 1))
    assert len(detect(tiles)) > 500
    assert len(matches_of(tiles[:320, :320], tiles[:320, 13:333])) < 10


def spiral(stride: int) -> tuple[Image, list[Camera]]:
    """Frames of a textured plane along a spiral that looks at its middle and rolls, every ``stride``-th of 60 poses."""
    image = texture()
    first = camera_of(image).resized(320, 320)
    frames, cameras = [], []
    for k in range(0, 60, stride):
        angle, radius = 2 * np.pi * k / 40, 0.2 + 0.9 * k / 60
        centre = np.array([radius * np.cos(angle), 0.6 * radius * np.sin(angle), -0.2 * np.sin(angle / 2)])
        forward = np.array([0, 0, DISTANCE]) - centre
        forward /= np.linalg.norm(forward)
        right = np.cross([0, 1.0, 0], forward)
        right /= np.linalg.norm(right)
        R = rotation("z", 1.2 * k) @ np.stack([right, np.cross(forward, right), forward])
        cameras.append(Camera(first.K, pose(R, -R @ centre), 320, 320))
        source = camera_of(image)
        frames.append(warp(image, plane_homography(source, cameras[-1], NORMAL, DISTANCE), 320))
    return np.stack(frames), cameras


@cache
def spiral_at_stride_five() -> tuple[Image, list[Camera]]:
    return spiral(5)


@cache
def spiral_score() -> SequenceScore:
    return score_sequence(*spiral_at_stride_five())


def test_a_spiral_passes_and_has_power() -> None:
    score = spiral_score()
    assert len(score.pairs) == 11
    assert score.tsed() == 1.0
    assert score.median_sed is not None
    assert score.median_sed < 0.2
    assert score.tsed(score.frozen) is not None
    assert score.tsed(score.frozen) < 0.5  # type: ignore[operator]
    assert score.powerless_against() == ()


def test_a_spiral_with_reversed_cameras_fails() -> None:
    frames, cameras = spiral_at_stride_five()
    assert score_sequence(frames, cameras[::-1]).tsed() == 0.0


def test_the_shifted_null_judges_each_pair_by_the_next_cameras() -> None:
    frames, cameras = spiral_at_stride_five()
    score = spiral_score()
    moved = score_sequence(frames[:-1], cameras[1:])
    assert score.shifted == moved.pairs
    assert len(score.shifted) == len(score.pairs) - 1
    assert score.tsed(score.shifted) < 0.7  # type: ignore[operator]


def test_no_match_is_dropped_unless_asked_for() -> None:
    """RANSAC hides the evidence: by default every mutual match enters the score."""
    frames = np.stack(planar().images)
    everything = matches_of(*planar().images)
    (kept,) = match_consecutive(frames, TsedConfig())
    np.testing.assert_array_equal(kept.x2, everything.x2)
    (filtered,) = match_consecutive(frames, TsedConfig(ransac_prefilter=True))
    assert 0 < len(filtered) < len(everything)


def test_threads_and_repeats_change_no_bit() -> None:
    frames, cameras = spiral_at_stride_five()
    one, two = (match_consecutive(frames[:4], TsedConfig(), threads) for threads in (1, 2))
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a.x1, b.x1)
        np.testing.assert_array_equal(a.x2, b.x2)
    full = spiral_score()
    again = score_sequence(frames[:4], cameras[:4], threads=1)
    # The extent max |C| differs, but no baseline is near zero: the first three verdicts are those of the whole.
    assert again.pairs == full.pairs[:3]
