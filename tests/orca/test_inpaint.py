"""Inpainting: only the hole changes, and failures have a type."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orca.errors import BadInput, Unknown
from orca.priors import classical
from orca.priors.inpaint import INPAINTERS, InpaintFailed

H, W = 40, 50
WITHOUT_WEIGHTS = [name for name in INPAINTERS if name != "sd15"]


def picture(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random((H, W, 3), dtype=np.float32)


def hole(top: int = 10, left: int = 12, height: int = 9, width: int = 14) -> np.ndarray:
    mask = np.zeros((H, W), bool)
    mask[top : top + height, left : left + width] = True
    return mask


@settings(max_examples=20, deadline=None)
@given(st.sampled_from(WITHOUT_WEIGHTS), st.integers(0, 38), st.integers(0, 48), st.integers(1, 40), st.integers(1, 40))
def test_only_the_hole_changes(name: str, top: int, left: int, height: int, width: int) -> None:
    image, mask = picture(), hole(top, left, height, width)
    image[mask] = np.nan  # what lies under the mask must not matter
    result = INPAINTERS.get(name)().inpaint(image, mask)
    assert result.dtype == np.float32
    np.testing.assert_array_equal(result[~mask], image[~mask])
    assert np.isfinite(result).all()
    assert result.min() >= 0
    assert result.max() <= 1


@pytest.mark.parametrize("name", WITHOUT_WEIGHTS)
def test_a_hole_in_a_flat_region_takes_its_colour(name: str) -> None:
    image = np.broadcast_to(np.array([0.2, 0.5, 0.8], np.float32), (H, W, 3)).copy()
    mask = hole()
    image[mask] = 0
    result = INPAINTERS.get(name)().inpaint(image, mask)
    np.testing.assert_allclose(result[mask], np.broadcast_to([0.2, 0.5, 0.8], (mask.sum(), 3)), atol=3 / 255)


def test_nearest_by_hand() -> None:
    image = np.zeros((H, W, 3), np.float32)
    image[:, W // 2 :] = 1
    mask = np.zeros((H, W), bool)
    mask[:, W // 2 - 3 : W // 2 + 3] = True
    result = INPAINTERS.get("nearest")().inpaint(image, mask)
    np.testing.assert_array_equal(result, image)


@pytest.mark.parametrize("name", WITHOUT_WEIGHTS)
def test_an_empty_mask_changes_nothing(name: str) -> None:
    image = picture()
    result = INPAINTERS.get(name)().inpaint(image, np.zeros((H, W), bool))
    np.testing.assert_array_equal(result, image)
    assert result is not image


@pytest.mark.parametrize("name", WITHOUT_WEIGHTS)
def test_bad_input_is_typed(name: str) -> None:
    inpainter = INPAINTERS.get(name)()
    with pytest.raises(BadInput, match="covers the whole"):
        inpainter.inpaint(picture(), np.ones((H, W), bool))
    with pytest.raises(BadInput, match="mask of shape"):
        inpainter.inpaint(picture(), np.zeros((H, W + 1), bool))
    with pytest.raises(BadInput, match="type uint8"):
        inpainter.inpaint(picture(), np.zeros((H, W), np.uint8))  # type: ignore[arg-type]
    image = picture()
    image[0, 0] = np.nan
    with pytest.raises(BadInput, match="NaN"):
        inpainter.inpaint(image, hole())


def test_a_failing_back_end_has_its_own_type(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise cv2.error("no")

    monkeypatch.setattr(classical.cv2, "inpaint", fail)
    with pytest.raises(InpaintFailed):
        INPAINTERS.get("telea")().inpaint(picture(), hole())


def test_unknown_name_has_a_hint() -> None:
    with pytest.raises(Unknown, match="did you mean 'telea'"):
        INPAINTERS.get("telae")
