"""Where a repair's anchors go: few on what is smooth, one a pixel where the target or its depth needs it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from orca.anchors import Stage
from orca.pipeline import _cell_error, _Run, reconstruct
from orca.render import Renderer
from orca.repair.donors import FillTarget
from orca.repair.insert import InsertConfig
from orca.repair.loop import repair
from orca.repair.spacing import TargetCells, cells_of, split_cells
from tests.orca.anchor_scenes import random_anchors
from tests.orca.repair_scenes import SIZE, estimate, input_camera, picture, sideways, small_config

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
    assert set(cells_of(target(mask, rgb, depth), 0.119, PLENTY).sides) == {2.0, 4.0}


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
    smooth = np.broadcast_to(np.linspace(0, 0.3, 11)[None, :, None], (13, 11, 3))
    cells = cells_of(target(mask, smooth, np.full((13, 11), 2.0)), tolerance, PLENTY)
    count = covered(cells, (16, 16))
    assert (count[:13, :11][mask] == 1).all()
    assert count.max() == 1
    # What lies outside is at most half of four, a quarter of sixteen.
    assert count.sum() - mask.sum() <= 2 * (cells.sides == 2).sum() + 4 * (cells.sides == 4).sum()


def test_cells_taken_apart_are_the_holes_own_pixels() -> None:
    mask, rgb, depth = wall()
    mask[:, 13:] = False  # of the last column of cells one pixel in four is in the hole
    mask[0, 12] = False
    rgb = rgb + np.linspace(0, 1e-3, 16)[:, None, None]
    fill = target(mask, rgb, depth)
    cells = cells_of(fill, 1.0, PLENTY)
    apart = split_cells(cells, cells.centres[:, 1] < 8, fill)
    assert (apart.sides[apart.centres[:, 1] < 8] == 1).all()
    assert np.array_equal(np.sort(apart.sides[apart.centres[:, 1] > 8]), np.sort(cells.sides[cells.centres[:, 1] > 8]))
    upper = apart.centres[:, 1] < 8
    assert np.array_equal(covered(apart.subset(upper), (16, 16))[:8], mask[:8])
    x, y = apart.centres[upper].astype(int).T
    assert np.array_equal(apart.rgb[upper], rgb[y, x].astype(np.float32))


def test_what_an_anchor_may_leave_decides_how_many_there_are() -> None:
    image, depth = picture()
    config = small_config(anchors_per_pixel=0.25)
    off = replace(config, repair=replace(config.repair, enabled=False))
    views, counts = sideways(0.3), []  # a hole that is wider than what the input would see of coarse cells
    scene = reconstruct(image, input_camera(), estimate(depth), views, off).scene
    for cell_error in (0.0, 10.0):
        insert = InsertConfig(cell_error=cell_error)
        made = repair(
            scene.anchors,
            scene.decoders,
            views,
            config.repair,
            config.render,
            insert,
            input_camera(),
            input_image=image,
        )
        counts.append(len(made.anchors) - len(scene.anchors))
        alpha = Renderer(made.anchors, scene.decoders, config.render).render(views[2]).alpha
        assert (alpha < 0.5).mean() < 0.004
    assert counts[1] < 0.85 * counts[0]


def test_the_better_the_image_is_fitted_the_less_a_repair_may_leave() -> None:
    """Worked by hand: 0.01 squared error a channel is 20 dB, so 0.03 a pixel; 4 pixels an anchor; six times."""
    image, _ = picture()
    anchors = random_anchors(0, SIZE * SIZE // 4, input_camera())
    assert bool((anchors.stage == int(Stage.ORIGINAL)).all())
    allowed = []
    for psnr in (20.0, 40.0, 90.0):
        run = _Run(small_config(), "cpu", torch.Generator(), lambda phase, done, total: None)
        run.record["input_psnr"]["fine_tuned"] = psnr
        allowed.append(_cell_error(anchors, image, run))
    assert allowed[:2] == pytest.approx([6 * 4 * 0.03, 6 * 4 * 0.0003])
    assert allowed[2] == pytest.approx(16 * 3 / 255**2)  # a level of 8 bits


def test_the_paper_gives_every_pixel_its_own() -> None:
    image, depth = picture()
    counts = {}
    for spread in ("need", "even"):
        config = small_config(anchors_per_pixel=0.25)
        config = replace(config, repair=replace(config.repair, spread=spread))
        made = reconstruct(image, input_camera(), estimate(depth), sideways(0.12), config)
        counts[spread] = int((made.scene.anchors.stage == int(Stage.REPAIRED)).sum())
    assert counts["need"] < 0.8 * counts["even"]
