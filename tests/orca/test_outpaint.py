"""Outpainting: the original stays, the border continues it, and the depth goes with the colours."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orca.errors import BadInput, Unknown
from orca.priors.outpaint import OUTPAINTERS, extend_depth

# "classical" and "sd15": test_priors_grow.py
NAMES = ["mean", "mirror", "edge"]
margin = st.integers(0, 90)


def picture(height: int = 40, width: int = 30, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random((height, width, 3), dtype=np.float32)


@settings(max_examples=25, deadline=None)
@given(margin, margin, margin, margin, st.sampled_from(NAMES))
def test_the_original_is_kept_bit_for_bit(left: int, top: int, right: int, bottom: int, name: str) -> None:
    image = picture()
    canvas = OUTPAINTERS.get(name)().outpaint(image, left, top, right, bottom)
    assert canvas.shape == (40 + top + bottom, 30 + left + right, 3)
    assert canvas.dtype == np.float32
    np.testing.assert_array_equal(canvas[top : top + 40, left : left + 30], image)
    assert canvas.min() >= image.min()
    assert canvas.max() <= image.max()


def test_no_margin_is_a_copy() -> None:
    image = picture()
    canvas = OUTPAINTERS.get("mirror")().outpaint(image, 0, 0, 0, 0)
    np.testing.assert_array_equal(canvas, image)
    assert canvas is not image


def test_mirror_starts_as_a_reflection_and_edge_as_a_copy() -> None:
    image = picture()
    mirror = OUTPAINTERS.get("mirror")().outpaint(image, 0, 0, 3, 0)
    edge = OUTPAINTERS.get("edge")().outpaint(image, 0, 0, 3, 0)
    # next to the frame the blur is a small fraction of a pixel
    assert np.abs(mirror[:, 30] - image[:, 29]).max() < 0.15
    assert np.abs(mirror[:, 31] - image[:, 28]).mean() < 0.5 * np.abs(mirror[:, 31] - image[:, 29]).mean()
    assert np.abs(edge[:, 32] - image[:, 29]).mean() < np.abs(mirror[:, 32] - image[:, 29]).mean()


def test_detail_fades_with_distance() -> None:
    canvas = OUTPAINTERS.get("mirror")().outpaint(picture(120, 120), 0, 0, 100, 0)
    detail = [float(canvas[:, x : x + 10].std()) for x in (110, 125, 150, 200)]
    assert detail == sorted(detail, reverse=True)
    assert detail[-1] < 0.2 * detail[0]


def test_a_constant_image_stays_constant() -> None:
    image = np.full((20, 20, 3), 0.3, np.float32)
    for name in NAMES:
        np.testing.assert_allclose(OUTPAINTERS.get(name)().outpaint(image, 50, 5, 0, 60), 0.3, atol=1e-6)


@pytest.mark.parametrize("mode", ["mirror", "edge"])
def test_depth_goes_with_the_colours(mode: str) -> None:
    y, x = np.mgrid[0:48, 0:64].astype(np.float32)
    depth = 2 + x / 32 + np.sin(y / 9)
    canvas = extend_depth(depth, 70, 20, 70, 20, mode)  # type: ignore[arg-type]
    np.testing.assert_array_equal(canvas[20:68, 70:134], depth)
    assert canvas.dtype == np.float32
    assert canvas.min() >= depth.min() * (1 - 1e-6)
    assert canvas.max() <= depth.max() * (1 + 1e-6)
    inside = np.abs(np.diff(depth, axis=0)).max() + np.abs(np.diff(depth, axis=1)).max()
    for row, column in ((19, slice(70, 134)), (67, slice(70, 134))):
        assert np.abs(np.diff(canvas, axis=0)[row, column]).max() <= inside
    assert np.abs(np.diff(canvas, axis=1)[20:68, [69, 133]]).max() <= inside


def test_depth_keeps_a_step_near_the_frame() -> None:
    depth = np.full((32, 32), 1.0, np.float32)
    depth[:16] = 4.0
    canvas = extend_depth(depth, 0, 0, 10, 0)
    np.testing.assert_allclose(canvas[:12, 33], 4.0, rtol=1e-3)
    np.testing.assert_allclose(canvas[20:, 33], 1.0, rtol=1e-3)


def test_bad_input_is_typed() -> None:
    mirror = OUTPAINTERS.get("mirror")()
    with pytest.raises(BadInput, match="margins"):
        mirror.outpaint(picture(), -1, 0, 0, 0)
    with pytest.raises(BadInput, match="shape"):
        mirror.outpaint(picture()[..., 0], 1, 1, 1, 1)
    with pytest.raises(BadInput, match="depth"):
        extend_depth(np.array([[1.0, np.nan]], np.float32), 1, 1, 1, 1)
    with pytest.raises(BadInput, match="margins"):
        extend_depth(np.ones((4, 4), np.float32), 0, 0, 0, -2)
    with pytest.raises(Unknown, match="mirror"):
        extend_depth(np.ones((4, 4), np.float32), 1, 1, 1, 1, "miror")  # type: ignore[arg-type]


@pytest.mark.slow
def test_the_mean_errs_least_beyond_cropped_photographs() -> None:
    """What was cut off a photograph is its own truth."""
    data = pytest.importorskip("skimage.data")
    cut, error = 48, dict.fromkeys(NAMES, 0.0)
    for name in ("astronaut", "chelsea", "coffee", "rocket"):
        photo = np.asarray(getattr(data, name)()[:384, :384, :3], np.float32) / 255
        inner = photo[cut:-cut, cut:-cut]
        for way in NAMES:
            made = OUTPAINTERS.get(way)().outpaint(inner, cut, cut, cut, cut)
            error[way] += float(np.square(made - photo).mean())
    assert error["mean"] < min(error["mirror"], error["edge"])
