"""Detector and matcher: exact positions, the matcher against a slow one, ties, empty input, threads."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from bench.metrics import matching
from bench.metrics.matching import MatchConfig, match_descriptors
from bench.metrics.sift import Features, SiftConfig, detect, detect_all
from orca.errors import BadInput
from tests.bench.tsed_reference import slow_matches
from tests.bench.tsed_scenes import texture, warp


def unit(rows: np.ndarray) -> np.ndarray:
    return (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32)


def random_pair(seed: int, n: int = 60, m: int = 75, noise: float = 0.05) -> tuple[np.ndarray, np.ndarray]:
    """Root-SIFT-like descriptors: 40 of the second set are noisy copies of the first, some ambiguous."""
    rng = np.random.default_rng(seed)
    first = rng.gamma(0.6, 1, (n, 128))
    second = rng.gamma(0.6, 1, (m, 128))
    copies = min(40, n, m)
    second[:copies] = first[:copies] + noise * rng.gamma(1, 1, (copies, 128))
    if n > 50:
        first[45:50] = first[:5] + noise * rng.gamma(1, 1, (5, 128))
    return unit(np.sqrt(first)), unit(np.sqrt(second))


def as_set(pair: tuple[np.ndarray, np.ndarray]) -> set[tuple[int, int]]:
    return set(zip(pair[0].tolist(), pair[1].tolist()))


@pytest.mark.parametrize("noise", [0.02, 0.1, 0.4])
@pytest.mark.parametrize("seed", range(3))
def test_matcher_equals_the_slow_one(seed: int, noise: float, monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = random_pair(seed, noise=noise)
    monkeypatch.setattr(matching, "BLOCK_ROWS", 17)  # several blocks, the last one ragged
    expected = slow_matches(first, second, 0.8, 0.7)
    assert as_set(match_descriptors(first, second)) == expected
    assert noise == 0.4 or len(expected) > 20


@pytest.mark.parametrize(("ratio", "max_angle"), [(0.9, 0.7), (0.6, 0.7), (1.0, 3.0), (0.8, 0.2)])
def test_matcher_equals_the_slow_one_at_other_thresholds(ratio: float, max_angle: float) -> None:
    first, second = random_pair(7, noise=0.2)
    found = as_set(match_descriptors(first, second, MatchConfig(ratio, max_angle)))
    assert found == slow_matches(first, second, ratio, max_angle)


def test_matcher_equals_the_slow_one_on_a_photograph() -> None:
    image = texture("astronaut")[100:260, 150:330]
    first, second = detect(image), detect(image[3:, 5:])
    found = as_set(match_descriptors(first.descriptors, second.descriptors))
    assert len(found) > 100
    assert found == slow_matches(first.descriptors, second.descriptors, 0.8, 0.7)


def angles(*degrees: float) -> np.ndarray:
    """Unit vectors in a plane at the given directions."""
    radians = np.radians(degrees)
    return np.stack([np.cos(radians), np.sin(radians)], axis=1).astype(np.float32)


def test_ratio_is_taken_of_angles() -> None:
    # 8 of 11 degrees is a ratio of .73 in angle but .98 in cosine; 9 of 11 is .82.
    assert as_set(match_descriptors(angles(0), angles(8, 11))) == {(0, 0)}
    assert as_set(match_descriptors(angles(0), angles(9, 11))) == set()


def test_ratio_is_taken_in_both_directions() -> None:
    assert as_set(match_descriptors(angles(8, 11), angles(0))) == {(0, 0)}
    assert as_set(match_descriptors(angles(9, 11), angles(0))) == set()


def test_matches_are_mutual() -> None:
    # The nearest of 0 is 10, but the nearest of 10 is 13.
    assert as_set(match_descriptors(angles(0, 13), angles(10, 170), MatchConfig(max_angle=0.7))) == {(1, 0)}


def test_the_largest_angle_is_0_7() -> None:
    assert as_set(match_descriptors(angles(0), angles(40.0))) == {(0, 0)}
    assert as_set(match_descriptors(angles(0), angles(40.2))) == set()


def test_exact_ties_fail() -> None:
    first, second = random_pair(0)
    assert (10, 10) in as_set(match_descriptors(first, second))
    again = slice(10, 11)
    for a, b in (
        (first, np.vstack([second, second[again]])),
        (np.vstack([first, first[again]]), second),
        (np.vstack([first, first[again]]), np.vstack([first, first[again]])),
    ):
        touched = {i for i, _ in as_set(match_descriptors(a, b))}
        assert 10 not in touched
        assert len(first) not in touched


def test_angles_below_the_resolution_of_float32_are_ties() -> None:
    # The last bit of a cosine: what two kernels of a BLAS may make of one product.
    almost = np.array([[1, 0], [np.nextafter(np.float32(1), np.float32(0)), 0]], np.float32)
    assert as_set(match_descriptors(almost[:1], almost)) == set()
    assert as_set(match_descriptors(almost, almost[:1])) == set()


def test_ties_fail_for_any_rounding_of_the_product() -> None:
    # Every descriptor five times, in rows that different kernels of the BLAS compute.
    tiles = np.tile(random_pair(1, 301, 10)[0], (5, 1))
    assert len(match_descriptors(tiles, tiles)[0]) == 0


def test_empty_and_single_descriptors() -> None:
    first, _ = random_pair(0)
    none = np.zeros((0, 128), np.float32)
    for a, b in ((none, first), (first, none), (none, none)):
        i, j = match_descriptors(a, b)
        assert len(i) == len(j) == 0
    assert as_set(match_descriptors(first[:1], first[:1])) == {(0, 0)}


def test_frozen_frames_match_themselves() -> None:
    first, _ = random_pair(3, 45)
    i, j = match_descriptors(first, first)
    np.testing.assert_array_equal(i, j)
    assert len(i) == 45


@pytest.mark.parametrize(("ratio", "max_angle"), [(0.0, 0.7), (1.2, 0.7), (0.8, 0.0), (0.8, float("nan"))])
def test_impossible_thresholds_are_refused(ratio: float, max_angle: float) -> None:
    with pytest.raises(BadInput, match="ratio"):
        MatchConfig(ratio, max_angle)


@pytest.mark.parametrize("name", ["astronaut", "chelsea"])
def test_a_half_turn_finds_the_same_places(name: str) -> None:
    # Biased positions show here: 0.50 px without the precise upscale, 1 px without the half pixel.
    image = texture(name)
    first, second = detect(image), detect(np.ascontiguousarray(image[::-1, ::-1]))
    i, j = match_descriptors(first.descriptors, second.descriptors)
    size = np.array([image.shape[1], image.shape[0]])
    assert len(i) > 200
    assert np.abs(np.median(size - first.points[i] - second.points[j], axis=0)).max() < 0.02


def test_positions_scale_with_the_image() -> None:
    # With pixel centres at +0.5 a resize by two is x -> 2x, with no offset.
    image = texture()[:256, :256]
    first, second = detect(image), detect(warp(image, np.diag([2.0, 2.0, 1.0]), 512))
    i, j = match_descriptors(first.descriptors, second.descriptors)
    assert np.abs(np.median(second.points[j] - 2 * first.points[i], axis=0)).max() < 0.1


def test_descriptors_are_unit_root_sift() -> None:
    image = texture()[:256, :256]
    features = detect(image)
    assert features.descriptors.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(features.descriptors, axis=1), 1, atol=1e-5)
    np.testing.assert_allclose((features.descriptors.astype(float) ** 2).sum(1), 1, atol=1e-5)
    raw = cv2.SIFT.create(0, 3, 0.02, 30, 1.6, True).detectAndCompute(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), None)[1]
    expected = np.sqrt(raw / raw.sum(axis=1, keepdims=True))
    np.testing.assert_allclose(features.descriptors, expected, atol=1e-5)


def test_constant_and_tiny_images_have_no_features() -> None:
    for shape in ((1, 1, 3), (1, 300, 3), (5, 5, 3), (64, 64, 3)):
        features = detect(np.full(shape, 127, np.uint8))
        assert features.points.shape == (0, 2)
        assert features.descriptors.shape == (0, 128)


def test_the_cap_keeps_the_larger_scales() -> None:
    image = texture()[:256, :256]
    everything, few = detect(image), detect(image, SiftConfig(max_keypoints=50))
    assert len(few) == 50 < len(everything)
    kept = {tuple(p) for p in few.points}
    assert kept <= {tuple(p) for p in everything.points}
    sizes = cv2.SIFT.create(0, 3, 0.02, 30, 1.6, True).detect(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), None)
    largest = sorted((k.size for k in sizes), reverse=True)[49]
    assert kept >= {(k.pt[0] + 0.5, k.pt[1] + 0.5) for k in sizes if k.size > largest}


def test_threads_and_repeats_change_no_bit() -> None:
    frames = [texture()[y : y + 160, 100:260] for y in (0, 60, 120, 180, 240)]
    before = cv2.getNumThreads()
    runs = [detect_all(frames, threads=threads) for threads in (1, 2, 2)]
    assert cv2.getNumThreads() == before
    for run in runs[1:]:
        for expected, found in zip(runs[0], run, strict=True):
            assert isinstance(found, Features)
            np.testing.assert_array_equal(found.points, expected.points)
            np.testing.assert_array_equal(found.descriptors, expected.descriptors)


@pytest.mark.parametrize(
    "frame", [np.zeros((8, 8, 3), np.float32), np.zeros((8, 8, 4), np.uint8), np.zeros(8, np.uint8)]
)
def test_other_images_are_refused(frame: np.ndarray) -> None:
    with pytest.raises(BadInput, match="frame of shape"):
        detect(frame)
