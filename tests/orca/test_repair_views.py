"""What is rendered again after an insertion: every touched pixel, once, and little more."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orca.repair.views import _patches


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**31), st.integers(1, 60), st.integers(0, 90))
def test_patches_cover_every_footprint_once(seed: int, count: int, widest: int) -> None:
    rng = np.random.default_rng(seed)
    corner = rng.integers(0, 300, (count, 2))
    boxes = np.concatenate([corner, corner + rng.integers(0, widest + 1, (count, 2))], 1).astype(np.int32)
    covered, touched = np.zeros((400, 400), np.int64), np.zeros((400, 400), bool)
    for x0, y0, x1, y1 in boxes:
        touched[y0:y1, x0:x1] = True
    for x0, y0, x1, y1 in _patches(boxes):
        covered[y0:y1, x0:x1] += 1
    assert covered.max(initial=0) <= 1
    assert (covered[touched] == 1).all()


@pytest.mark.parametrize("bend", [0, 1])
def test_a_thin_hole_along_a_diagonal_costs_little(bend: int) -> None:
    at = np.arange(0, 400, 4)
    boxes = np.stack([at, at * bend, at + 6, at * bend + 6], 1).astype(np.int32)
    area = sum((x1 - x0) * (y1 - y0) for x0, y0, x1, y1 in _patches(boxes))
    assert area <= (400 * 400 // 4 if bend else 402 * 6)


def test_nothing_touched_is_nothing_rendered() -> None:
    assert _patches(np.array([[5, 5, 5, 9], [7, 3, 2, 8]], np.int32)) == []
