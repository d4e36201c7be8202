"""The quadtree: an exact partition within the budget, fine where image and depth ask for it."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orca.config import PlacementConfig
from orca.stages.placement import LEVELS, Cells, Quadtree, quadtree
from tests.orca.stage_inputs import picture, random_depth

CONFIG = PlacementConfig()


def place(
    image: np.ndarray,
    budget: int,
    depth: np.ndarray | None = None,
    importance: np.ndarray | None = None,
    config: PlacementConfig = CONFIG,
) -> Cells:
    ones = np.ones(image.shape[:2], np.float32)
    return quadtree(image, ones if depth is None else depth, ones if importance is None else importance, budget, config)


def roots(height: int, width: int) -> int:
    return -(-height // LEVELS[0]) * -(-width // LEVELS[0])


def cell_map(cells: Cells, height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """How many cells cover each pixel of the image, and the size of the cell there."""
    padded = (height + 8, width + 8)
    count, size = np.zeros(padded, int), np.zeros(padded)
    for (x, y), side in zip(cells.centres, cells.sizes, strict=True):
        box = slice(round(y - side / 2), round(y + side / 2)), slice(round(x - side / 2), round(x + side / 2))
        count[box] += 1
        size[box] = side
    return count[:height, :width], size[:height, :width]


def noise(height: int, width: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random((height, width, 3), dtype=np.float32)


@settings(max_examples=40, deadline=None)
@given(st.integers(16, 70), st.integers(16, 70), st.integers(1, 4000), st.integers(0, 1000))
def test_every_pixel_lies_in_exactly_one_cell_and_the_budget_holds(
    height: int, width: int, budget: int, seed: int
) -> None:
    random = np.random.default_rng(seed)
    cells = place(picture(height, width, seed), budget, random_depth(height, width, random))
    assert len(cells.sizes) <= max(budget, roots(height, width))
    count, _ = cell_map(cells, height, width)
    assert (count == 1).all()
    assert set(cells.sizes) <= set(LEVELS)
    # A cell of side s sits on the grid of step s.
    np.testing.assert_array_equal((cells.centres / cells.sizes[:, None]) % 1, 0.5)


@pytest.mark.parametrize("budget", [1, 100, 500, 1000, 4096])
def test_cells_cover_whole_blocks_exactly(budget: int) -> None:
    cells = place(picture(64, 64), budget)
    assert np.square(cells.sizes).sum() == 64 * 64


def test_the_budget_is_used_up_where_there_is_texture() -> None:
    for budget in (100, 1000, 3000):
        assert 0.95 * budget < len(place(noise(64, 64), budget).sizes) <= budget


def test_a_budget_of_one_cell_a_pixel_gives_every_pixel_its_own() -> None:
    cells = place(noise(32, 24), 32 * 24)
    assert (cells.sizes == 1).all()
    assert len(cells.sizes) == 32 * 24


def test_too_small_a_budget_gives_the_coarsest_cells() -> None:
    cells = place(noise(64, 48), 5)
    assert (cells.sizes == 8).all()
    assert len(cells.sizes) == 48


@pytest.mark.parametrize("colour", [0.0, 0.1, 0.3, 0.7, 1.0])
def test_a_flat_image_stays_coarse_whatever_the_budget(colour: float) -> None:
    cells = place(np.full((64, 64, 3), colour, np.float32), 2000)
    assert (cells.sizes == 8).all()


def test_the_textured_half_gets_the_fine_cells() -> None:
    image = np.full((64, 64, 3), 0.4, np.float32)
    image[:, 32:] = noise(64, 32)
    _, size = cell_map(place(image, 900), 64, 64)
    assert (size[:, :24] == 8).all()  # a step of the frame's interpolation may split the cells next to it
    assert size[:, 32:].mean() < 3


def test_finer_texture_gets_finer_cells() -> None:
    x = np.arange(64)
    stripes = np.where(x < 32, np.sin(2 * np.pi * x / 24), np.sin(2 * np.pi * x / 5)) * 0.4 + 0.5
    image = np.repeat(np.tile(stripes, (64, 1))[:, :, None], 3, axis=2).astype(np.float32)
    _, size = cell_map(place(image, 800), 64, 64)
    assert size[:, 36:60].mean() < 0.5 * size[:, 4:28].mean()


def test_a_depth_edge_attracts_cells_even_without_texture() -> None:
    image, depth = np.full((64, 64, 3), 0.4, np.float32), np.ones((64, 64), np.float32)
    depth[:, 36:] = 2.0
    _, size = cell_map(place(image, 900, depth), 64, 64)
    assert (size[:, 34:38] == 1).all()
    assert (size[:, :32] == 8).all()
    assert (size[:, 40:] == 8).all()
    without = replace(CONFIG, edge_weight=0.0)
    assert (place(image, 900, depth, config=without).sizes == 8).all()


def test_a_depth_step_below_the_edge_ratio_is_no_edge() -> None:
    image, depth = np.full((64, 64, 3), 0.4, np.float32), np.ones((64, 64), np.float32)
    depth[:, 36:] = CONFIG.edge_ratio - 0.01
    assert (place(image, 900, depth).sizes == 8).all()


def test_what_does_not_matter_stays_coarse() -> None:
    importance = np.ones((64, 64), np.float32)
    importance[:32] = 0
    depth = np.ones((64, 64), np.float32)
    depth[:, 36:] = 2.0
    _, size = cell_map(place(noise(64, 64), 1500, depth, importance), 64, 64)
    assert (size[:32] == 8).all()
    assert size[32:].mean() < 2


def test_more_important_texture_goes_first() -> None:
    importance = np.ones((64, 64), np.float32)
    importance[:, :32] = 0.1
    _, size = cell_map(place(noise(64, 64), 1000, importance=importance), 64, 64)
    assert size[:, 32:].mean() < 0.6 * size[:, :32].mean()


def test_the_smallest_image() -> None:
    cells = place(noise(16, 16), 64)
    assert 4 <= len(cells.sizes) <= 64
    assert np.square(cells.sizes).sum() == 256


def test_the_same_input_gives_the_same_cells() -> None:
    first, second = place(picture(40, 50), 300), place(picture(40, 50), 300)
    np.testing.assert_array_equal(first.centres, second.centres)
    np.testing.assert_array_equal(first.sizes, second.sizes)


def tree(image: np.ndarray, margin: np.ndarray | None = None) -> Quadtree:
    ones = np.ones(image.shape[:2], np.float32)
    return Quadtree(image, ones, ones, CONFIG, margin)


def test_more_cells_leave_less_error_and_a_cell_a_pixel_none() -> None:
    errors = [tree(picture(64, 64)).error(budget) for budget in (64, 300, 1000, 2000, 3500, 4096)]
    assert errors == sorted(errors, reverse=True)
    assert errors[0] > errors[-2] > errors[-1] == 0


def test_without_splits_the_error_is_that_of_the_reduced_image() -> None:
    image = picture(64, 64)
    small = cv2.resize(image, (8, 8), interpolation=cv2.INTER_AREA)
    left = np.square(cv2.resize(small, (64, 64), interpolation=cv2.INTER_CUBIC) - image).sum()
    assert tree(image).error(64) == pytest.approx(left, rel=1e-5)


def test_the_error_in_the_margin_is_nobodys_input_view() -> None:
    image, margin = np.full((64, 64, 3), 0.5, np.float32), np.zeros((64, 64), bool)
    margin[:, 32:] = True
    image[:, 48:] = picture(64, 16)
    assert tree(image, margin).error(16) == pytest.approx(0, abs=1e-6)
    assert tree(image).error(64) > 1


def test_shares_say_what_splits_remove() -> None:
    image = np.full((16, 40, 3), 0.5, np.float32)
    image[::2, :8] = 0.8  # rows of a pixel: only cells of a pixel help
    centres = [[4.0, 4.0], [36.0, 4.0], [2.0, 10.0], [1.0, 13.0], [0.5, 15.5]]
    cells = Cells(np.array(centres), np.array([8.0, 8, 4, 2, 1]))
    # Three levels down are 21 splits, two 5, one 1; what has no error is told the same; a pixel cannot be split.
    np.testing.assert_allclose(tree(image).shares(cells), [1 / 21, 1 / 21, 1 / 5, 1, 0], atol=0.02)


@settings(max_examples=20, deadline=None)
@given(st.integers(16, 70), st.integers(16, 70), st.integers(0, 1000))
def test_shares_are_shares(height: int, width: int, seed: int) -> None:
    image = picture(height, width, seed)
    whole = tree(image)
    cells = whole.cells(height * width // 5)
    shares = whole.shares(cells)
    assert ((shares >= 0) & (shares <= 1)).all()
    np.testing.assert_array_equal(shares == 0, cells.sizes == 1)
