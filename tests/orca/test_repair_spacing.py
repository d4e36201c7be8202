"""Where a repair's anchors go: few on what is smooth, one a pixel where the target or its depth needs it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orca.anchors import Stage
from orca.config import GrowthConfig
from orca.pipeline import Reconstruction, reconstruct
from orca.repair.donors import FillTarget
from orca.repair.spacing import TargetCells, cells_of
from tests.orca.repair_scenes import estimate, input_camera, picture, sideways, small_config

PLENTY = 10_000


def target(mask: np.ndarray, rgb: np.ndarray, depth: np.ndarray) -> FillTarget:
    """A fill of the pixels of a mask."""
    y, x = np.nonzero(mask)
    return FillTarget(y, x, rgb[y, x].astype(np.float32), depth[y, x].astype(np.float32), 0, "test:all", 0.0)


def covered(cells: TargetCells, shape: tuple[int, int]) -> np.ndarray:
    """How many cells each pixel lies in, [H, W]."""
    count = np.zeros(shape, int)
    for (x, y), side in zip(cells.centres, cells.sides, strict=True):
        left, top = round(x - side / 2), round(y - side / 2)
        count[top : top + int(side), left : left + int(side)] += 1
    return count


def wall(size: int = 16) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A square hole in a wall of one colour at one depth."""
    return np.ones((size, size), bool), np.full((size, size, 3), 0.4), np.full((size, size), 2.0)


def test_a_flat_wall_takes_an_anchor_for_sixteen_pixels() -> None:
    cells = cells_of(target(*wall()), 1e-4, PLENTY)
    assert np.array_equal(cells.sides, np.full(16, 4.0))
    assert np.allclose(cells.rgb, 0.4)
    assert np.allclose(cells.depth, 2.0)
    assert np.array_equal(covered(cells, (16, 16)), np.ones((16, 16)))


def test_without_tolerance_every_pixel_has_its_own() -> None:
    cells = cells_of(target(*wall()), 0.0, PLENTY)
    assert len(cells.sides) == 256
    assert set(cells.sides) == {1.0}


def test_texture_takes_an_anchor_a_pixel_as_far_as_the_tolerance_asks() -> None:
    mask, rgb, depth = wall()
    rgb[:, 8:] += 0.1 * (np.indices((16, 8)).sum(0) % 2)[..., None]
    fine, coarse = (cells_of(target(mask, rgb, depth), tolerance, PLENTY) for tolerance in (0.01, 1.0))
    right = fine.centres[:, 0] > 8
    assert set(fine.sides[right]) == {1.0}
    assert set(fine.sides[~right]) == {4.0}
    # Sixteen pixels of the checkerboard leave 3 * 16 * 0.05^2 = 0.12.
    assert set(coarse.sides) == {4.0}
    assert set(cells_of(target(mask, rgb, depth), 0.119, PLENTY).sides[:]) == {2.0, 4.0}


def test_no_cell_crosses_from_one_surface_to_another() -> None:
    mask, rgb, depth = wall()
    depth[:, 6:] = 2.2
    cells = cells_of(target(mask, rgb, depth), 1.0, PLENTY)
    assert np.allclose(np.where(cells.centres[:, 0] < 6, 2.0, 2.2), cells.depth)
    assert np.array_equal(covered(cells, (16, 16)), np.ones((16, 16)))
    depth[:, 6:] = 2.08  # 4 %: one surface
    assert len(cells_of(target(mask, rgb, depth), 1.0, PLENTY).sides) == 16


def test_too_many_become_a_regular_grid() -> None:
    mask, rgb, depth = wall()
    rgb += np.random.default_rng(0).random(rgb.shape)
    cells = cells_of(target(mask, rgb, depth), 1e-9, 100)
    assert np.array_equal(cells.sides, np.full(64, 2.0))


@given(st.integers(0, 2**32 - 1), st.floats(0.05, 0.95), st.floats(1e-4, 1.0))
def test_every_pixel_of_a_hole_is_covered_once(seed: int, share: float, tolerance: float) -> None:
    rng = np.random.default_rng(seed)
    mask = rng.random((13, 11)) < share
    if not mask.any():
        return
    smooth = np.linspace(0, 0.3, 11)[None, :, None] + 0 * rng.random((13, 11, 3))
    cells = cells_of(target(mask, smooth, np.full((13, 11), 2.0)), tolerance, PLENTY)
    count = covered(cells, (16, 16))
    assert (count[:13, :11][mask] == 1).all()
    assert count.max() == 1
    # What lies outside is at most half of four, a quarter of sixteen.
    assert count.sum() - mask.sum() <= 2 * (cells.sides == 2).sum() + 4 * (cells.sides == 4).sum()


@pytest.fixture(scope="module")
def by_target() -> dict[float, Reconstruction]:
    """One textured picture, grown to two qualities."""
    image, depth = picture()
    noisy = np.clip(image + 0.05 * np.random.default_rng(0).standard_normal(image.shape), 0, 1).astype(np.float32)
    out = {}
    for quality in (28.0, 40.0):
        config = replace(small_config(), growth=GrowthConfig(target_psnr=quality))
        out[quality] = reconstruct(noisy, input_camera(), estimate(depth), sideways(0.12), config)
    return out


def test_repairs_follow_the_quality_asked_for(by_target: dict[float, Reconstruction]) -> None:
    low, high = (by_target[quality].record["anchors"] for quality in (28.0, 40.0))
    assert low["repaired"] < 0.7 * high["repaired"]
    for made in by_target.values():
        alpha = made.scene.renderer().render(sideways(0.12)[2]).alpha
        assert (alpha < 0.5).mean() < 0.004


def test_the_paper_gives_every_pixel_its_own() -> None:
    image, depth = picture()
    counts = {}
    for spread in ("need", "even"):
        config = small_config(anchors_per_pixel=0.25)
        config = replace(config, repair=replace(config.repair, spread=spread))  # type: ignore[arg-type]
        made = reconstruct(image, input_camera(), estimate(depth), sideways(0.12), config)
        counts[spread] = int((made.scene.anchors.stage == int(Stage.REPAIRED)).sum())
    assert counts["need"] < 0.8 * counts["even"]
