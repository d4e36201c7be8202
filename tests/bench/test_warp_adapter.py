"""The warp baselines: holes, coverage, true views, and the motorcycle pair."""

from __future__ import annotations

import numpy as np

from bench.adapters import METHODS
from bench.adapters.adapter import RunOptions
from bench.adapters.warp import WARP, WARP_TELEA
from bench.datasets.case import TrueView
from bench.metrics.metric import MetricInput
from bench.metrics.reference import TrueViewScores
from tests.bench.small_cases import camera_of, make_case, noise_image, plane, shifted_pose, smooth_image

H, W = 24, 40


def test_registered_under_their_names() -> None:
    assert METHODS.get("warp") is WARP
    assert METHODS.get("warp-telea") is WARP_TELEA
    assert (WARP.name, WARP_TELEA.name) == ("warp", "warp-telea")
    assert WARP.version(RunOptions()) != WARP_TELEA.version(RunOptions())


def test_warp_leaves_holes_black_and_says_where() -> None:
    camera = camera_of(H, W)
    step = 5 * 2.0 / camera.K[0, 0]
    case = make_case(noise_image(H, W), plane(H, W), [np.eye(4), shifted_pose(x=step)])
    output = WARP.run(case, RunOptions())
    np.testing.assert_array_equal(output.frames[0], case.image)
    np.testing.assert_array_equal(output.frames[1][:, :-5], case.image[:, 5:])
    assert output.coverage is not None
    assert output.coverage.dtype == np.float32
    assert output.coverage[0].all()
    assert output.coverage[1].sum() == H * (W - 5)
    assert (output.frames[1][output.coverage[1] == 0] == 0).all()
    assert output.input_view is not None
    np.testing.assert_array_equal(output.input_view, case.image)
    assert output.true_views == ()
    assert output.model["is_warp_reference"] is True
    assert output.timing["render"] > 0


def test_telea_fills_every_hole_and_keeps_the_rest() -> None:
    camera = camera_of(H, W)
    pose = shifted_pose(x=5 * 2.0 / camera.K[0, 0])
    case = make_case(np.full((H, W, 3), 200, np.uint8), plane(H, W), [pose])
    output = WARP_TELEA.run(case, RunOptions())
    np.testing.assert_allclose(output.frames, 200, atol=4)  # OpenCV's Telea drifts by a level or so on the way in
    np.testing.assert_array_equal(output.frames[:, :, :-5], 200)
    assert output.coverage is not None
    assert (output.coverage == 1).all()
    case = make_case(smooth_image(H, W), plane(H, W), [pose])
    np.testing.assert_array_equal(
        WARP_TELEA.run(case, RunOptions()).frames[0][:, :-5], WARP.run(case, RunOptions()).frames[0][:, :-5]
    )


def test_a_view_that_sees_nothing_is_black_not_a_crash() -> None:
    case = make_case(noise_image(H, W), plane(H, W), [shifted_pose(z=5.0)])
    output = WARP_TELEA.run(case, RunOptions())
    assert (output.frames == 0).all()


def test_true_views_have_their_own_size_and_progress_is_told() -> None:
    seen: list[tuple[str, int, int]] = []
    view = TrueView(camera_of(12, 16), noise_image(12, 16), np.zeros((12, 16), np.bool_))
    case = make_case(noise_image(H, W), plane(H, W), [np.eye(4)], (view,))
    output = WARP.run(case, RunOptions(progress=lambda phase, done, total: seen.append((phase, done, total))))
    assert output.true_views is not None
    assert output.true_views[0].shape == (12, 16, 3)
    assert seen == [("render", 2, 2)]


def test_motorcycle_warp_and_telea_against_the_real_second_view() -> None:
    """What a user gets by hand, to be beaten: 23.6 dB, 16.8 dB on the holes, SSIM .878."""
    from dataclasses import replace

    from bench.datasets.photos import Photos

    case = replace(Photos().load("motorcycle"), eval_indices=(0,))
    scores = TrueViewScores().compute(MetricInput(case, WARP_TELEA.run(case, RunOptions())))
    assert scores["psnr"].value is not None
    assert abs(scores["psnr"].value - 23.60) < 0.05
    assert scores["hole_psnr"].value is not None
    assert abs(scores["hole_psnr"].value - 16.84) < 0.05
    assert scores["ssim"].value is not None
    assert abs(scores["ssim"].value - 0.878) < 0.001
