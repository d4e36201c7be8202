"""What finer cells could take off an error, against values worked by hand."""

from __future__ import annotations

import numpy as np
import pytest

from orca.stages.captured import captured
from orca.stages.placement import Cells


def cells(*rows: tuple[float, float, float]) -> Cells:
    """Cells from (x, y, side)."""
    array = np.array(rows)
    return Cells(array[:, :2], array[:, 2])


def grey(values: np.ndarray) -> np.ndarray:
    """One channel of an error; the two others lack nothing."""
    return np.stack([values, np.zeros_like(values), np.zeros_like(values)], 2).astype(np.float32)


def test_a_checkerboard_of_quarters_is_captured_by_one_split() -> None:
    error = np.array([[1, 1, -1, -1], [1, 1, -1, -1], [-1, -1, 1, 1], [-1, -1, 1, 1]], float)
    # The cell's mean is 0, those of its quarters +-1: all 16 go, for one split.
    assert captured(cells((2, 2, 4)), grey(error)) == pytest.approx([16.0])


def test_a_checkerboard_of_pixels_takes_five_splits() -> None:
    error = np.indices((4, 4)).sum(0) % 2 * 2.0 - 1
    # Quarters of 2 x 2 pixels have mean 0; the pixels hold all 16, for 1 + 4 splits.
    assert captured(cells((2, 2, 4)), grey(error)) == pytest.approx([16 / 5])


def test_what_the_cell_itself_can_hold_does_not_count() -> None:
    assert captured(cells((2, 2, 4)), grey(np.ones((4, 4)))) == pytest.approx([0.0])
    assert captured(cells((0.5, 0.5, 1), (1.5, 0.5, 1)), grey(np.ones((1, 2)))) == pytest.approx([0.0, 0.0])


def test_cells_of_several_sizes_beyond_the_border() -> None:
    """Picture of 6 x 4: a cell of 4, then a cell of 4 that half lies outside, where nothing is lacking."""
    error = np.zeros((4, 6))
    error[:, 4] = 1.0
    # Quarters of the right cell: means 1/2, 0, 1/2, 0, its own 1/4: (4/4 + 4/4) - 16/16 = 1 for one split. Pixels hold
    # 4 of it: 3 for five splits. The first is better.
    assert captured(cells((2, 2, 4), (6, 2, 4)), grey(error)) == pytest.approx([0.0, 1.0])
