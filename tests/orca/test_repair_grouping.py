"""Bridged components: a torn silhouette is one thing to repair."""

from __future__ import annotations

import numpy as np
import pytest

from orca.repair.components import connected_components, drop_small
from orca.repair.rules import RepairRules


def dotted(gap: int, dots: int = 5) -> np.ndarray:
    """A row of 2x2 dots, ``gap`` covered pixels apart."""
    mask = np.zeros((20, 60), bool)
    for i in range(dots):
        x = 4 + i * (2 + gap)
        mask[8:10, x : x + 2] = True
    return mask


@pytest.mark.parametrize(("gap", "bridge", "expected"), [(1, 0, 5), (4, 4, 1), (5, 4, 5), (2, 2, 1), (3, 2, 5)])
def test_pieces_up_to_the_bridge_apart_are_one(gap: int, bridge: int, expected: int) -> None:
    assert len(connected_components(dotted(gap), bridge=bridge)) == expected


def test_the_pixels_between_stay_out() -> None:
    mask = dotted(4)
    (component,) = connected_components(mask, bridge=4)
    assert component.area == mask.sum() == 20
    assert np.array_equal(component.full_mask(*mask.shape), mask)
    assert component.bbox == (4, 8, 4 + 5 * 2 + 4 * 4, 10)


def test_drop_small_keeps_what_connected_components_keeps() -> None:
    rng = np.random.default_rng(0)
    mask = rng.random((50, 70)) < 0.15
    for bridge in (0, 3):
        kept = np.zeros_like(mask)
        for component in connected_components(mask, 6, bridge):
            kept |= component.full_mask(*mask.shape)
        assert np.array_equal(drop_small(mask, 6, bridge), kept)
    assert not drop_small(np.zeros((4, 4), bool), 1).any()


def test_the_bridge_scales_with_the_side() -> None:
    assert RepairRules(bridge=4).scaled(1024, 1024).bridge == 8
    assert RepairRules(bridge=0).scaled(1024, 1024).bridge == 0
