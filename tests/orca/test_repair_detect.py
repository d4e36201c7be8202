"""Detection of missing pixels and their connected components."""

from __future__ import annotations

import numpy as np
import pytest

from orca.errors import BadInput
from orca.repair.components import Component, connected_components
from orca.repair.detect import disocclusion_area, disocclusion_mask
from orca.repair.rules import RepairRules

RULES = RepairRules()


def covered(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    return np.ones((height, width), np.float32), np.ones((height, width), np.float32)


def test_threshold_is_inclusive_for_covered_pixels() -> None:
    alpha, depth = covered(9, 20)
    alpha[4, 4], alpha[4, 15] = 0.7999, 0.8
    assert np.argwhere(disocclusion_mask(alpha, depth, RULES)).tolist() == [[4, 4]]


@pytest.mark.parametrize("bad", [np.nan, np.inf, 0.0, -1.0])
def test_a_pixel_without_usable_depth_is_missing(bad: float) -> None:
    alpha, depth = covered(8, 8)
    depth[3, 3] = bad
    assert np.argwhere(disocclusion_mask(alpha, depth, RULES)).tolist() == [[3, 3]]


def test_nan_alpha_is_missing() -> None:
    alpha, depth = covered(8, 8)
    alpha[2, 5] = np.nan
    assert disocclusion_mask(alpha, depth, RULES)[2, 5]


def test_a_sieve_becomes_one_region() -> None:
    alpha, depth = covered(40, 60)
    alpha[10:30:2, 10:50:2] = 0.0
    mask = disocclusion_mask(alpha, depth, RULES)
    assert [component.area for component in connected_components(mask)] == [19 * 39]
    plain = disocclusion_mask(alpha, depth, RepairRules(closing_radius=0))
    assert disocclusion_area(plain) == 200
    assert len(connected_components(plain)) == 200


def test_closing_never_drops_a_missing_pixel_and_leaves_the_border_alone() -> None:
    rng = np.random.default_rng(0)
    alpha, depth = covered(37, 53)
    alpha[rng.random(alpha.shape) < 0.05] = 0.0
    alpha[:, -2:] = 0.0
    closed = disocclusion_mask(alpha, depth, RULES)
    assert closed[alpha < 0.5].all()
    alpha, depth = covered(20, 20)
    alpha[0:4, 0:4] = 0.0
    assert np.array_equal(disocclusion_mask(alpha, depth, RULES), alpha < 0.5)


def test_all_and_nothing_missing() -> None:
    alpha, depth = covered(12, 31)
    nothing = disocclusion_mask(alpha, depth, RULES)
    assert not nothing.any()
    assert connected_components(nothing) == []
    assert disocclusion_area(nothing) == 0
    everything = disocclusion_mask(np.zeros_like(alpha), depth, RULES)
    (component,) = connected_components(everything)
    assert (component.area, component.bbox, component.fill) == (12 * 31, (0, 0, 31, 12), 1.0)


def test_area_counts_only_components_that_are_large_enough() -> None:
    mask = np.zeros((20, 20), bool)
    mask[2:6, 2:6] = True
    mask[10:13, 10:15] = True
    mask[18, 18] = True
    assert [disocclusion_area(mask, n) for n in (1, 2, 15, 16, 17)] == [32, 31, 31, 16, 0]


def test_components_are_ordered_eight_connected_and_complete() -> None:
    mask = np.zeros((30, 50), bool)
    mask[5, 5] = mask[6, 6] = mask[7, 5] = True  # touch at corners only: one component
    mask[20, 40] = mask[20, 10] = mask[3, 30] = True
    mask[10:20, 20:30] = True
    found = connected_components(mask)
    assert [(c.area, c.bbox) for c in found] == [
        (100, (20, 10, 30, 20)),
        (3, (5, 5, 7, 8)),
        (1, (30, 3, 31, 4)),
        (1, (10, 20, 11, 21)),
        (1, (40, 20, 41, 21)),
    ]
    assert (found[1].fill, found[1].short_side) == (0.5, 2)
    union = sum(c.full_mask(30, 50).astype(int) for c in found)
    assert np.array_equal(union, mask.astype(int))
    assert [c.area for c in connected_components(mask, 3)] == [100, 3]


def test_pixels_and_full_mask_agree() -> None:
    mask = np.random.default_rng(1).random((23, 41)) < 0.3
    for component in connected_components(mask):
        y, x = component.pixels()
        again = np.zeros_like(mask)
        again[y, x] = True
        assert np.array_equal(again, component.full_mask(23, 41))


@pytest.mark.parametrize("size", [(8, 9), (0, 0)])
def test_buffers_of_two_sizes_or_none_are_refused(size: tuple[int, int]) -> None:
    with pytest.raises(BadInput, match="alpha of shape"):
        disocclusion_mask(np.ones((0, 0) if size == (0, 0) else (8, 8), np.float32), np.ones(size, np.float32), RULES)


def test_wrong_masks_are_refused() -> None:
    with pytest.raises(BadInput, match="bool mask"):
        connected_components(np.ones((4, 4), np.uint8))  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="component with a mask"):
        Component(np.zeros((2, 2), bool), (0, 0, 2, 2))
    with pytest.raises(BadInput, match="component with a mask"):
        Component(np.ones((2, 3), bool), (0, 0, 2, 3))
