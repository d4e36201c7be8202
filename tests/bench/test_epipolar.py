"""Fundamental matrix, homography and their distances: laws, hand-worked values, an independent oracle."""

from __future__ import annotations

import numpy as np
import pytest

from bench.metrics.epipolar import (
    fundamental_matrix,
    homography_transfer_distance,
    infinite_homography,
    is_zero_baseline,
    largest_center_norm,
    symmetric_epipolar_distance,
)
from orca.camera import Camera
from tests.bench.tsed_reference import sed_by_projection
from tests.bench.tsed_scenes import SIZE, cloud, matches_of, pose, rotation, view

MOTIONS = {
    "lateral": view(t=(0.4, 0, 0)),
    "vertical": view(t=(0, -0.3, 0)),
    "forward": view(t=(0, 0, -0.8)),
    "turn": view(rotation("y", 12) @ rotation("x", -7) @ rotation("z", 20), (0.5, -0.2, 0.3)),
    "other_lens": Camera(
        np.array([[700.0, 0, 180], [0, 650, 300], [0, 0, 1]]), pose(rotation("y", -6), (0.3, 0.1, -0.4)), 400, 600
    ),
}
START = view(rotation("x", 3) @ rotation("y", -5), (0.2, -0.1, 0.3))


def sed(first: Camera, second: Camera, x1: np.ndarray, x2: np.ndarray) -> np.ndarray:
    return symmetric_epipolar_distance(fundamental_matrix(first, second), x1, x2)


@pytest.mark.parametrize("name", MOTIONS)
def test_exact_motion_has_no_distance(name: str) -> None:
    x1, x2 = matches_of(START, MOTIONS[name])
    assert sed(START, MOTIONS[name], x1, x2).max() < 1e-8


@pytest.mark.parametrize("name", MOTIONS)
def test_distance_equals_the_oracle_that_draws_the_lines(name: str) -> None:
    second = MOTIONS[name]
    x1, x2 = matches_of(START, second, cloud(1, 40))
    rng = np.random.default_rng(2)
    x1, x2 = x1 + rng.normal(0, 5, x1.shape), x2 + rng.normal(0, 5, x2.shape)
    np.testing.assert_allclose(sed(START, second, x1, x2), sed_by_projection(START, second, x1, x2), rtol=1e-6)


def test_hand_value_lateral() -> None:
    # The epipolar lines of a sideways step are the rows: y 20 against 23 is 3 px from both lines.
    x1, x2 = np.array([[100.0, 20.0]]), np.array([[80.0, 23.0]])
    assert sed(view(), view(t=(0.4, 0, 0)), x1, x2)[0] == pytest.approx(3.0, abs=1e-12)


def test_hand_value_twice_the_size() -> None:
    # y 20 becomes 40 in an image twice as large; 42 is 2 px off there and 1 px off here: mean 1.5.
    second = view(t=(0.4, 0, 0)).resized(2 * SIZE, 2 * SIZE)
    x1, x2 = np.array([[100.0, 20.0]]), np.array([[160.0, 42.0]])
    assert sed(view(), second, x1, x2)[0] == pytest.approx(1.5, abs=1e-12)
    assert sed(second, view(), x2, x1)[0] == pytest.approx(1.5, abs=1e-12)


def noisy(name: str = "turn") -> tuple[Camera, Camera, np.ndarray, np.ndarray]:
    x1, x2 = matches_of(START, MOTIONS[name])
    return START, MOTIONS[name], x1, x2 + np.random.default_rng(3).normal(0, 2, x2.shape)


@pytest.mark.parametrize("factor", [-1.0, 1e-9, -3e6])
def test_scale_and_sign_of_f_do_not_matter(factor: float) -> None:
    first, second, x1, x2 = noisy()
    F = fundamental_matrix(first, second)
    np.testing.assert_allclose(
        symmetric_epipolar_distance(factor * F, x1, x2), symmetric_epipolar_distance(F, x1, x2), rtol=1e-7
    )


@pytest.mark.parametrize("name", MOTIONS)
def test_swapping_the_frames_changes_nothing(name: str) -> None:
    first, second, x1, x2 = noisy(name)
    np.testing.assert_allclose(sed(second, first, x2, x1), sed(first, second, x1, x2), rtol=1e-7)


def test_length_and_sign_of_the_translation_do_not_matter() -> None:
    first, second = view(), view(rotation("y", 4), (0.2, 0.1, 0.3))
    x1, x2 = matches_of(first, second)
    x2 = x2 + np.random.default_rng(4).normal(0, 2, x2.shape)
    longer = Camera(second.K, pose(second.rotation, -10 * second.translation), SIZE, SIZE)
    np.testing.assert_allclose(sed(first, longer, x1, x2), sed(first, second, x1, x2), rtol=1e-7)


def test_world_similarity_changes_nothing() -> None:
    first, second, x1, x2 = noisy()
    R, shift, scale = rotation("y", 70) @ rotation("x", 30), np.array([4.0, -2, 9]), 7.5

    def moved(camera: Camera) -> Camera:
        # X' = s R X + c: the camera's own axes now measure s times as long.
        rotated = camera.rotation @ R.T
        return Camera(camera.K, pose(rotated, scale * camera.translation - rotated @ shift), SIZE, SIZE)

    np.testing.assert_allclose(sed(moved(first), moved(second), x1, x2), sed(first, second, x1, x2), rtol=1e-7)


@pytest.mark.parametrize("scale", [0.5, 3.0])
def test_resizing_scales_the_distance(scale: float) -> None:
    first, second, x1, x2 = noisy("turn")
    size = int(scale * SIZE)
    resized = sed(first.resized(size, size), second.resized(size, size), scale * x1, scale * x2)
    np.testing.assert_allclose(resized, scale * sed(first, second, x1, x2), rtol=1e-7)


def test_sliding_along_the_epipolar_lines_goes_unseen() -> None:
    # A documented blind spot: content may run along its lines (a wrong depth) and the distance stays 0.
    first, second = view(), view(t=(0.4, 0, 0))
    x1, x2 = matches_of(first, second)
    x2[:, 0] += np.random.default_rng(5).uniform(-40, 40, len(x2))
    assert sed(first, second, x1, x2).max() < 1e-8


@pytest.mark.parametrize("t", [(0.4, 0, 0), (0, 0, -0.5), (0.1, -0.2, 0.3)])
def test_frozen_video_under_pure_translation_goes_unseen(t: tuple[float, float, float]) -> None:
    x1, _ = matches_of(view(), view(t=t))
    assert sed(view(), view(t=t), x1, x1).max() < 1e-8


def test_a_match_on_the_epipole_is_infinite_and_not_nan() -> None:
    first, second = view(), view(t=(0, 0, -0.8))
    centre = np.array([[SIZE / 2, SIZE / 2]])
    assert np.isinf(sed(first, second, centre, centre)).all()
    x1, x2 = matches_of(first, second)
    mixed = sed(first, second, np.vstack([x1, centre]), np.vstack([x2, centre]))
    assert np.median(mixed) < 1e-8
    assert not np.isnan(mixed).any()


def test_homography_transfer_by_hand() -> None:
    # H doubles; 42 for 40 is 2 px there and 1 px back: mean 1.5.
    H = np.diag([2.0, 2.0, 1.0])
    x1, x2 = np.array([[10.0, 20.0]]), np.array([[20.0, 42.0]])
    assert homography_transfer_distance(H, x1, x2)[0] == pytest.approx(1.5, abs=1e-12)


def test_rotation_about_the_centre_is_the_infinite_homography() -> None:
    first = view()
    second = Camera(np.array([[700.0, 0, 180], [0, 650, 300], [0, 0, 1]]), pose(rotation("y", 5)), 400, 600)
    x1, x2 = matches_of(first, second)
    assert homography_transfer_distance(infinite_homography(first, second), x1, x2).max() < 1e-9
    assert homography_transfer_distance(infinite_homography(second, first), x1, x2).max() > 10


@pytest.mark.parametrize("H", [np.zeros((3, 3)), np.full((3, 3), np.nan), np.ones((3, 3))])
def test_degenerate_homographies_are_infinitely_far(H: np.ndarray) -> None:
    assert np.isinf(homography_transfer_distance(H, np.ones((4, 2)), np.ones((4, 2)))).all()


def test_degenerate_inputs_never_raise() -> None:
    F = fundamental_matrix(view(), view(t=(0.4, 0, 0)))
    assert symmetric_epipolar_distance(F, np.zeros((0, 2)), np.zeros((0, 2))).shape == (0,)
    assert homography_transfer_distance(np.eye(3), np.zeros((0, 2)), np.zeros((0, 2))).shape == (0,)
    assert np.isinf(symmetric_epipolar_distance(np.zeros((3, 3)), np.ones((5, 2)), np.ones((5, 2)))).all()
    assert np.isinf(symmetric_epipolar_distance(np.full((3, 3), np.nan), np.ones((5, 2)), np.ones((5, 2)))).all()


R5 = rotation("y", 5)
CENTRE = np.array([1.0, 2.0, 3.0])


@pytest.mark.parametrize(
    "second",
    [
        pose(R5, -R5 @ CENTRE),
        pose(R5, -R5 @ CENTRE + 1e-9),
        pose(R5, -R5 @ (CENTRE + np.array([1e-7, -1e-7, 1e-7]))),
        pose(R5, -R5 @ CENTRE).astype(np.float32).astype(np.float64),
    ],
    ids=["exact", "1e-9", "dust", "float32"],
)
def test_zero_baseline_is_seen_through_rounding(second: np.ndarray) -> None:
    cameras = (view(t=-CENTRE), Camera(view().K, second, SIZE, SIZE))
    assert is_zero_baseline(*cameras, largest_center_norm(cameras))


def test_zero_baseline_at_the_origin_and_small_true_baselines() -> None:
    assert is_zero_baseline(view(), view(R5), 0.0)
    assert is_zero_baseline(view(), view(R5, (1e-9, 0, 0)), 0.0)
    assert not is_zero_baseline(view(), view(t=(1e-4, 0, 0)), 1.0)
    assert largest_center_norm(()) == 0.0
    assert largest_center_norm((view(t=-CENTRE), view())) == pytest.approx(np.linalg.norm(CENTRE))
