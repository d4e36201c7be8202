"""Exemplars continue what can be continued, and average what cannot."""

from __future__ import annotations

import numpy as np
import pytest

from orca.repair.patches import MOST_CANDIDATES, SPAN, compare, lowest, make_spans, short_list
from orca.repair.structure import ExemplarRules, continue_structure

RULES = ExemplarRules(radius=4, matches=12)
SIZE = 80


def half_known() -> tuple[np.ndarray, np.ndarray]:
    """Source: everything but the 14 columns of the hole and what lies beyond them."""
    source, hole = np.zeros((SIZE, SIZE), bool), np.zeros((SIZE, SIZE), bool)
    source[:, :56] = True
    hole[:, 56:70] = True
    return source, hole


def stripes(period: float, angle: float) -> np.ndarray:
    y, x = np.mgrid[0:SIZE, 0:SIZE]
    wave = 0.5 + 0.3 * np.tanh(4 * np.sin(2 * np.pi * (np.cos(angle) * x + np.sin(angle) * y) / period))
    return np.repeat(wave[..., None], 3, 2).astype(np.float32) * np.float32([1.0, 0.8, 0.6])


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(-10 * np.log10(np.mean((a - b) ** 2)))


@pytest.mark.parametrize("angle", [0.0, 0.5, 1.2])
@pytest.mark.parametrize("period", [10.0, 16.0])
def test_stripes_go_on(period: float, angle: float) -> None:
    image = stripes(period, angle)
    source, hole = half_known()
    made = continue_structure(image, np.ones((SIZE, SIZE), np.float32), source, hole, RULES)
    assert made is not None
    rgb, _, filled = made
    assert filled[hole].all()
    assert not filled[~hole].any()
    assert psnr(rgb[hole], image[hole]) > 22
    # What a flat smear of the best single colour would reach:
    assert psnr(rgb[hole], image[hole]) > 6 + psnr(np.broadcast_to(image[hole].mean(0), rgb[hole].shape), image[hole])


def test_a_ramp_of_colour_and_a_plane_of_depth_go_on() -> None:
    y, x = np.mgrid[0:SIZE, 0:SIZE]
    ramp = np.stack([0.2 + 0.005 * x, 0.3 + 0.004 * y, 0.5 + 0 * x], 2).astype(np.float32)
    inverse = (0.3 + 0.002 * x + 0.001 * y).astype(np.float32)
    source, hole = half_known()
    made = continue_structure(ramp, inverse, source, hole, RULES)
    assert made is not None
    assert np.abs(made[0][hole] - ramp[hole]).max() < 0.02
    np.testing.assert_allclose(made[1][hole], inverse[hole], rtol=1e-3)


def test_noise_is_averaged_and_not_copied() -> None:
    random = np.random.default_rng(0)
    image = random.uniform(0.2, 0.8, (SIZE, SIZE, 3)).astype(np.float32)
    source, hole = half_known()
    made = continue_structure(image, np.ones((SIZE, SIZE), np.float32), source, hole, RULES)
    assert made is not None
    assert made[0][hole].std() < 0.6 * image[hole].std()
    one = continue_structure(image, np.ones((SIZE, SIZE), np.float32), source, hole, ExemplarRules(4, 1))
    assert one is not None
    assert psnr(made[0][hole], image[hole]) > 1.5 + psnr(one[0][hole], image[hole])


def test_what_is_neither_source_nor_hole_is_never_read() -> None:
    image = stripes(12.0, 0.3)
    source, hole = half_known()
    spoilt = image.copy()
    spoilt[:, 70:] = np.nan
    inverse = np.where(source, 1.0, np.nan).astype(np.float32)
    clean = continue_structure(image, np.ones((SIZE, SIZE), np.float32), source, hole, RULES)
    other = continue_structure(spoilt, inverse, source, hole, RULES)
    assert clean is not None
    assert other is not None
    np.testing.assert_array_equal(clean[0][hole], other[0][hole])
    assert np.isfinite(other[1][hole]).all()


def test_an_island_stays_unfilled_and_too_small_a_source_is_refused() -> None:
    image = stripes(12.0, 0.0)
    source, hole = half_known()
    hole[:, 60:64] = False  # cuts the hole in two; the far part touches no source
    made = continue_structure(image, np.ones((SIZE, SIZE), np.float32), source, hole, RULES)
    assert made is not None
    assert made[2][:, 56:60].all()
    assert not made[2][:, 64:70].any()
    few = np.zeros_like(source)
    few[:12, :12] = True
    assert continue_structure(image, np.ones((SIZE, SIZE), np.float32), few, hole, RULES) is None


def test_the_same_twice() -> None:
    image = np.random.default_rng(1).uniform(0, 1, (SIZE, SIZE, 3)).astype(np.float32)
    source, hole = half_known()
    one, two = (continue_structure(image, np.ones((SIZE, SIZE), np.float32), source, hole, RULES) for _ in range(2))
    assert one is not None
    assert two is not None
    np.testing.assert_array_equal(one[0], two[0])


@pytest.mark.parametrize(("count", "shifts"), [(700, 9), (60, 5), (3000, 26)])
def test_the_short_list_is_the_lowest_of_all_costs(count: int, shifts: int) -> None:
    rng = np.random.default_rng(count)
    pixels = rng.uniform(0, 1, (4, 6000)).astype(np.float32)
    # Stretches with gaps, single ones, and more on end than a span is long.
    candidates = np.sort(rng.choice(np.arange(500, 5500), count, replace=False))
    offsets = np.sort(rng.choice(np.arange(-400, 400), shifts, replace=False))
    bounds, same = make_spans(candidates)
    np.testing.assert_array_equal(same, candidates)
    listed = short_list(pixels, candidates, bounds, 3000, offsets, 0.5, 40)
    cost, _ = compare(pixels, candidates, 3000, offsets, 0.5)
    np.testing.assert_array_equal(listed, candidates[lowest(cost, 40)])


def test_of_too_many_candidates_whole_spans_are_kept() -> None:
    candidates = np.concatenate([np.arange(row * 400, row * 400 + 130 + row % 7) for row in range(300)])
    bounds, kept = make_spans(candidates)
    assert 0.9 * MOST_CANDIDATES < len(kept) < 1.1 * MOST_CANDIDATES
    assert np.isin(kept, candidates).all()
    assert (np.diff(kept) > 0).all()
    np.testing.assert_array_equal(bounds[1:, 0], bounds[:-1, 1])
    assert (bounds[0, 0], bounds[-1, 1]) == (0, len(kept))
    assert all(kept[end - 1] - kept[first] < SPAN for first, end in bounds)
