"""PSNR, SSIM and input PSNR: hand values, an independent reference, and a reason for every missing value."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from bench.adapters.adapter import MethodOutput
from bench.datasets.case import SceneCase, TrueView
from bench.metrics import METRICS
from bench.metrics.fidelity import mean_squared_error, psnr_of_mse, read_at, resize_to, ssim, ssim_inside
from bench.metrics.metric import MetricInput, Score
from bench.metrics.reference import InputPsnr, TrueViewScores
from orca.errors import BadInput
from tests.bench.small_cases import camera_of, make_case, noise_image, plane, smooth_image

H, W = 40, 48


def case_with_true_view(image: NDArray[np.uint8], hidden: NDArray[np.bool_] | None = None) -> SceneCase:
    height, width = image.shape[:2]
    mask = np.zeros((height, width), np.bool_) if hidden is None else hidden
    view = TrueView(camera_of(height, width), image, mask)
    return make_case(noise_image(height, width), plane(height, width), [np.eye(4)], (view,))


def true_view_scores(case: SceneCase, *renders: NDArray[np.uint8]) -> dict[str, Score]:
    return TrueViewScores().compute(MetricInput(case, MethodOutput(case.image[None], true_views=renders)))


def input_score(case: SceneCase, view: NDArray[np.uint8] | None) -> Score:
    return InputPsnr().compute(MetricInput(case, MethodOutput(case.image[None], input_view=view)))["input_psnr"]


def test_psnr_of_one_grey_level_is_48_13_db() -> None:
    image = np.full((H, W, 3), 100, np.uint8)
    scores = true_view_scores(case_with_true_view(image), image + 1)
    assert scores["psnr"].value == pytest.approx(20 * math.log10(255), abs=1e-9)
    assert scores["psnr"].n == 1


def test_differences_do_not_wrap_around() -> None:
    black, white = np.zeros((H, W, 3), np.uint8), np.full((H, W, 3), 255, np.uint8)
    assert mean_squared_error(black, white) == mean_squared_error(white, black) == 255.0**2
    assert psnr_of_mse(255.0**2) == 0.0


def test_hole_psnr_looks_at_the_hidden_pixels_only() -> None:
    image = np.full((H, W, 3), 100, np.uint8)
    hidden = np.zeros((H, W), np.bool_)
    hidden[:, :10] = True
    render = image.copy()
    render[hidden] += 10
    render[~hidden] += 1
    scores = true_view_scores(case_with_true_view(image, hidden), render)
    assert scores["hole_psnr"].value == pytest.approx(10 * math.log10(255**2 / 100))
    share = 10 / W
    assert scores["psnr"].value == pytest.approx(10 * math.log10(255**2 / (100 * share + 1 - share)))


def test_ssim_equals_the_formula_written_out() -> None:
    """Wang et al. 2004 with a uniform 7x7 window and sample covariance, over whole windows, per channel."""
    a, b = smooth_image(H, W), noise_image(H, W, 4)
    b = cv2.addWeighted(a, 0.7, b, 0.3, 0)
    windows = [
        np.lib.stride_tricks.sliding_window_view(x.astype(np.float64), (7, 7), axis=(0, 1)).reshape(-1, 3, 49)
        for x in (a, b)
    ]
    mean_a, mean_b = (x.mean(axis=2) for x in windows)
    var_a, var_b = (x.var(axis=2, ddof=1) for x in windows)
    covariance = ((windows[0] - mean_a[..., None]) * (windows[1] - mean_b[..., None])).sum(axis=2) / 48
    c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
    map_ = (2 * mean_a * mean_b + c1) * (2 * covariance + c2) / ((mean_a**2 + mean_b**2 + c1) * (var_a + var_b + c2))
    assert ssim(a, b) == pytest.approx(map_.mean(), abs=1e-6)


def window_ssim(a: NDArray[np.uint8], b: NDArray[np.uint8], y: int, x: int) -> float:
    """SSIM of the one 7x7 window around a pixel, mean over the channels, by the formula."""
    p, q = (i[y - 3 : y + 4, x - 3 : x + 4].reshape(49, 3).astype(np.float64) for i in (a, b))
    c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
    m, n = p.mean(0), q.mean(0)
    covariance = ((p - m) * (q - n)).sum(0) / 48
    top = (2 * m * n + c1) * (2 * covariance + c2)
    return float((top / ((m**2 + n**2 + c1) * (p.var(0, ddof=1) + q.var(0, ddof=1) + c2))).mean())


def test_masked_ssim_is_the_mean_of_the_windows_around_masked_pixels() -> None:
    a, b = smooth_image(H, W), noise_image(H, W, 4)
    b = cv2.addWeighted(a, 0.7, b, 0.3, 0)
    mask = np.zeros((H, W), np.bool_)
    mask[5, 7] = mask[20, 30] = True
    mask[0, 0] = mask[H - 1, 11] = True  # no whole window around these
    expected = (window_ssim(a, b, 5, 7) + window_ssim(a, b, 20, 30)) / 2
    assert ssim_inside(a, b, mask) == pytest.approx(expected, abs=1e-6)
    assert ssim_inside(a, b, np.ones((H, W), np.bool_)) == pytest.approx(ssim(a, b), abs=1e-12)
    border = np.zeros((H, W), np.bool_)
    border[:3] = True
    assert ssim_inside(a, b, border) is None
    found = true_view_scores(case_with_true_view(a, mask), b)["hole_ssim"]
    assert found.value == pytest.approx(expected, abs=1e-6)
    reason = true_view_scores(case_with_true_view(a, border), b)["hole_ssim"].reason
    assert reason == "no whole 7x7 window around a hidden pixel"


def test_scores_equal_scikit_image() -> None:
    from skimage.metrics import peak_signal_noise_ratio, structural_similarity

    a, b = smooth_image(H, W), cv2.addWeighted(smooth_image(H, W), 0.6, noise_image(H, W, 2), 0.4, 0)
    hidden = np.zeros((H, W), np.bool_)
    hidden[8:30, 20:] = True
    found = true_view_scores(case_with_true_view(a, hidden), b)
    assert found["psnr"].value == pytest.approx(peak_signal_noise_ratio(a, b, data_range=255), abs=1e-9)
    masked = peak_signal_noise_ratio(a[hidden], b[hidden], data_range=255)
    assert found["hole_psnr"].value == pytest.approx(masked, abs=1e-9)
    assert found["ssim"].value == pytest.approx(structural_similarity(a, b, channel_axis=2, data_range=255), abs=1e-9)


def test_masking_is_not_painting() -> None:
    """Equal paint outside the mask would raise every score: 10 levels inside a quarter of the image are 28.1 dB."""
    image = np.full((H, W, 3), 100, np.uint8)
    hidden = np.zeros((H, W), np.bool_)
    hidden[: H // 2, : W // 2] = True
    render = np.where(hidden[..., None], image + 10, noise_image(H, W))
    found = true_view_scores(case_with_true_view(image, hidden), render)
    assert found["hole_psnr"].value == pytest.approx(20 * math.log10(25.5))


def test_reading_between_pixels() -> None:
    image = np.zeros((2, 3, 3), np.uint8)
    image[0, 1], image[1, 1] = 100, 200
    at = np.array([[1.5, 0.5], [1.5, 1.0], [1.0, 0.5], [1.25, 1.5]])
    np.testing.assert_allclose(read_at(image, at)[:, 0], [100, 150, 50, 150], atol=1e-3)
    assert read_at(image, np.zeros((0, 2))).shape == (0, 3)


def test_more_noise_blur_and_holes_are_worse() -> None:
    image = smooth_image(H, W)
    case = case_with_true_view(image, np.ones((H, W), np.bool_))
    noise = np.random.default_rng(0).normal(size=image.shape)
    noisy = [np.clip(image + s * noise, 0, 255).astype(np.uint8) for s in (2, 8, 32)]
    blurred = [cv2.GaussianBlur(image, (0, 0), s) for s in (1, 2, 4)]
    where = np.random.default_rng(1).random((H, W))
    holes = [np.where((where < share)[..., None], np.uint8(0), image) for share in (0.02, 0.1, 0.5)]
    for ladder in (noisy, blurred, holes):
        scores = [true_view_scores(case, render) for render in ladder]
        for name in ("psnr", "ssim", "hole_psnr", "hole_ssim"):
            values = [s[name].value for s in scores]
            assert values == sorted(values, key=lambda x: -math.inf if x is None else -x)
            assert len(set(values)) == 3


def test_an_identical_image_has_no_finite_psnr_but_ssim_one() -> None:
    image = smooth_image(H, W)
    scores = true_view_scores(case_with_true_view(image, np.ones((H, W), np.bool_)), image)
    assert scores["psnr"].value is None
    assert scores["psnr"].reason == "identical to the reference (infinite PSNR)"
    assert scores["hole_psnr"].value is None
    assert scores["ssim"].value == pytest.approx(1.0)


def test_two_views_are_averaged_in_db() -> None:
    image = np.full((H, W, 3), 100, np.uint8)
    view = TrueView(camera_of(H, W), image, np.zeros((H, W), np.bool_))
    case = make_case(image, plane(H, W), [np.eye(4)], (view, view))
    score = true_view_scores(case, image + 1, image + 10)["psnr"]
    assert score.value == pytest.approx(20 * math.log10(255) - 10)
    assert score.n == 2


def test_missing_values_say_why() -> None:
    image = noise_image(H, W)
    no_view = make_case(image, plane(H, W), [np.eye(4)])
    assert true_view_scores(no_view)["psnr"].reason == "no true view in this data set"
    case = case_with_true_view(image)
    cannot = TrueViewScores().compute(MetricInput(case, MethodOutput(image[None])))
    assert {s.reason for s in cannot.values()} == {"the method cannot render at the true view's camera"}
    assert true_view_scores(case, image)["hole_psnr"].reason == "nothing is hidden in the true view"
    tiny = noise_image(5, 5)
    assert "smaller than the 7x7 window" in str(true_view_scores(case_with_true_view(tiny), tiny)["ssim"].reason)


def test_a_wrong_number_of_renders_is_refused() -> None:
    with pytest.raises(BadInput, match="2 renders for 1 true views"):
        true_view_scores(case_with_true_view(noise_image(H, W)), noise_image(H, W), noise_image(H, W))


def test_a_render_of_another_size_is_resized() -> None:
    image = np.full((H, W, 3), 100, np.uint8)
    score = true_view_scores(case_with_true_view(image), np.full((2 * H, 2 * W, 3), 101, np.uint8))["psnr"]
    assert score.value == pytest.approx(20 * math.log10(255))


def test_shrinking_averages_areas() -> None:
    checker = np.zeros((4, 4, 3), np.uint8)
    checker[::2] = 100
    np.testing.assert_array_equal(resize_to(checker, 2, 2), 50)
    assert resize_to(checker, 4, 4) is checker


def test_comparing_nothing_or_unequal_shapes_is_refused() -> None:
    image = noise_image(H, W)
    with pytest.raises(BadInput, match="no pixel to compare"):
        mean_squared_error(image, image, np.zeros((H, W), np.bool_))
    with pytest.raises(BadInput, match="two uint8 RGB images of one size"):
        mean_squared_error(image, image[1:])
    with pytest.raises(BadInput, match="two uint8 RGB images"):
        mean_squared_error(image.astype(np.float32) / 255, image)  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="at least 7 pixels"):
        ssim(image[:6], image[:6])


@pytest.mark.parametrize("shift", [(0.5, 0.0), (-0.5, 0.5), (1.0, -1.0), (0.0, 0.0)])
def test_input_psnr_undoes_a_half_pixel_drift(shift: tuple[float, float]) -> None:
    image = smooth_image(H, W)
    case = make_case(image, plane(H, W), [np.eye(4)])
    move = np.array([[1, 0, -shift[0]], [0, 1, -shift[1]]])
    drifted = cv2.warpAffine(image, move, (W, H), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    drifted[10, 10] ^= 1  # not identical
    score = input_score(case, drifted)
    assert score.detail["shift"] == list(shift)
    assert score.value is not None
    assert score.value > 40
    if shift != (0.0, 0.0):
        assert score.value > score.detail["unregistered"] + 6


def test_input_psnr_cannot_undo_a_larger_drift() -> None:
    image = noise_image(H, W)
    score = input_score(make_case(image, plane(H, W), [np.eye(4)]), np.roll(image, 3, axis=1))
    assert score.value is not None
    assert score.value < 15


def test_input_psnr_missing_identical_resized_and_tiny() -> None:
    image = smooth_image(H, W)
    case = make_case(image, plane(H, W), [np.eye(4)])
    assert "no view at the input camera" in str(input_score(case, None).reason)
    same = input_score(case, image)
    assert (same.value, same.reason) == (None, "identical to the reference (infinite PSNR)")
    smaller = input_score(case, cv2.resize(image, (W - 4, H - 4), interpolation=cv2.INTER_AREA))
    assert smaller.value is not None
    assert smaller.value > 25
    one = make_case(np.full((1, 1, 3), 9, np.uint8), plane(1, 1), [np.eye(4)])
    assert input_score(one, np.full((1, 1, 3), 10, np.uint8)).value == pytest.approx(20 * math.log10(255))


def test_specs_belong_to_the_registry() -> None:
    for name in METRICS:
        if not name.startswith("tsed"):
            assert name in {spec.id for spec in METRICS.get(name)().specs(None)}
