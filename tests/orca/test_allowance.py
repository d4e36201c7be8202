"""How many anchors may be placed, and which splits fit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orca.config import GrowthConfig, PlacementConfig
from orca.errors import BadInput
from orca.stages.allowance import Allowance
from orca.stages.canvas import Canvas
from orca.stages.placement import Cells, quadtree, split_cells
from tests.orca.stage_inputs import picture, view


def canvas(left: int = 0, top: int = 0, width: int = 32, height: int = 32) -> Canvas:
    """An original of 32 x 32 in a canvas with a margin on the left and above."""
    shape = (top + height, left + width)
    image = np.zeros((*shape, 3), np.float32)
    return Canvas(image, np.ones(shape, np.float32), view(width, height).padded(left, top, 0, 0), (left, top, 0, 0))


def tiles(side: float, columns: int, rows: int) -> Cells:
    x, y = np.meshgrid((np.arange(columns) + 0.5) * side, (np.arange(rows) + 0.5) * side)
    return Cells(np.stack([x.ravel(), y.ravel()], 1), np.full(columns * rows, side))


def test_every_cell_counts_where_the_margin_does() -> None:
    some = tiles(8, 5, 4)  # 4 of the 20 lie in the margin
    allowed = Allowance.of(canvas(left=8), GrowthConfig(max_anchors=29))
    assert allowed.count(some) == 20
    assert allowed.chosen(some, np.array([7, 0, 1, 2, 3]), 99).nonzero()[0].tolist() == [0, 1, 7]  # 9 fit
    assert allowed.words == "reached 29 anchors"


def test_the_margin_comes_on_top() -> None:
    some = tiles(8, 5, 4)
    allowed = Allowance.of(canvas(left=8), GrowthConfig(max_inside=22, margin_share=0.5))
    assert (allowed.most, allowed.margin, allowed.count(some)) == (22, 11, 16)
    assert not allowed.full(some)
    # Cells 0, 5, 10 and 15 are the margin's, which has 4 of 11: two splits fit, and two of the others.
    chosen = allowed.chosen(some, np.array([0, 1, 5, 10, 2, 3]), 99)
    assert chosen.nonzero()[0].tolist() == [0, 1, 2, 5]
    after, _ = split_cells(some, chosen, 40, 32)
    assert (allowed.count(after), len(after.sizes)) == (22, 32)
    assert allowed.full(after)
    assert allowed.words == "reached 22 anchors inside the image"


def test_cells_across_the_border_count_as_their_quarters_do() -> None:
    some = tiles(8, 5, 4)
    allowed = Allowance.of(canvas(left=6), GrowthConfig(max_inside=100))
    # Column 0 spans x = 0 to 8; its right quarters, centred at 6, lie inside: a split adds two that count.
    order = np.arange(20)
    assert allowed.count(some) == 16
    chosen = allowed.chosen(some, order[:1], 99)
    after, _ = split_cells(some, chosen, 38, 32)
    assert allowed.count(after) == 18


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 20), st.integers(0, 20), st.integers(80, 600), st.integers(0, 200), st.integers(0, 99))
def test_no_round_goes_beyond_what_is_allowed(left: int, top: int, most: int, splits: int, seed: int) -> None:
    where = canvas(left, top)
    height, width = where.depth.shape
    ones = np.ones((height, width), np.float32)
    some = quadtree(picture(height, width, seed), ones, ones, 70, PlacementConfig())
    allowed = Allowance.of(where, GrowthConfig(max_inside=most, margin_share=0.3)).at_least(some)
    order = np.random.default_rng(seed).permutation(np.flatnonzero(some.sizes > 1))
    chosen = allowed.chosen(some, order, splits)
    after, _ = split_cells(some, chosen, width, height)
    count = allowed.count(after)
    assert count <= allowed.most
    assert count - allowed.count(some) <= max(3, 3 * splits)
    assert allowed.margin is not None
    before = len(some.sizes) - allowed.count(some)
    assert len(after.sizes) - count <= max(before, allowed.margin)


def test_a_start_larger_than_allowed_is_refused_or_is_the_count() -> None:
    some = tiles(8, 4, 4)
    with pytest.raises(BadInput, match="16 or more"):
        Allowance.of(canvas(), GrowthConfig(max_anchors=10)).at_least(some)
    allowed = Allowance.of(canvas(), GrowthConfig(max_inside=10)).at_least(some)
    assert (allowed.most, allowed.full(some)) == (16, True)
