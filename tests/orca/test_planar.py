"""Stage 1's anchors: where they stand, how large they are, and that they cover the picture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from orca.anchors import Stage
from orca.config import PlacementConfig, PlanarConfig, RenderConfig
from orca.field.decoders import analytic_decoders
from orca.render.renderer import Renderer
from orca.stages.canvas import Canvas
from orca.stages.planar import PLANE_DEPTH, place, planar_anchors, regular_grid, rest_positions
from tests.orca.stage_inputs import bare_canvas, picture, view

GRID = PlanarConfig(placement=PlacementConfig(kind="grid"))
QUADTREE = PlanarConfig()


def padded_canvas(width: int, height: int, margins: tuple[int, int, int, int]) -> Canvas:
    left, top, right, bottom = margins
    size = (height + top + bottom, width + left + right)
    return Canvas(picture(*size), np.ones(size, np.float32), view(width, height).padded(*margins), margins)


def test_a_quarter_anchor_per_pixel_of_512_is_65536_two_pixels_apart() -> None:
    grid = regular_grid(bare_canvas(np.zeros((512, 512, 3), np.float32)), GRID)
    assert len(grid.pixels) == 65_536
    assert (grid.spacing == 2).all()
    assert grid.in_original.all()
    # Cell centres, row by row: (1, 1), (3, 1), ...
    expected = np.stack(np.meshgrid(np.arange(1, 512, 2), np.arange(1, 512, 2)), -1).reshape(-1, 2)
    np.testing.assert_allclose(grid.pixels, expected, atol=1e-9)


def test_one_anchor_per_pixel_stands_on_pixel_centres() -> None:
    grid = regular_grid(bare_canvas(picture(20, 30)), replace(GRID, anchors_per_pixel=1.0))
    assert len(grid.pixels) == 600
    np.testing.assert_allclose(grid.pixels % 1, 0.5)


@settings(max_examples=60, deadline=None)
@given(
    st.integers(16, 80),
    st.integers(16, 80),
    st.tuples(*[st.integers(0, 90)] * 4),
    st.sampled_from([1.0, 0.25, 0.1]),
    st.sampled_from([1.0, 2.0, 3.0]),
)
def test_the_margin_grid_goes_round_the_original_and_covers_the_canvas(
    width: int, height: int, margins: tuple[int, int, int, int], per_pixel: float, margin_spacing: float
) -> None:
    canvas = padded_canvas(width, height, margins)
    left, top, right, bottom = margins
    config = replace(GRID, anchors_per_pixel=per_pixel, margin_spacing=margin_spacing)
    grid = regular_grid(canvas, config)
    inner, outer = grid.pixels[grid.in_original], grid.pixels[~grid.in_original]
    alone = regular_grid(bare_canvas(picture(height, width)), config)
    np.testing.assert_allclose(inner, alone.pixels + np.array([left, top]), atol=1e-9)
    if not len(outer):
        assert not any(margins)
        return
    # No cell of the margin reaches into the original: in x or in y its centre is half a cell or more outside.
    beyond = np.maximum(np.array([left, top]) - outer, outer - np.array([left + width, top + height]))
    cell = np.array([width / max(1, round(width / (per_pixel**-0.5 * margin_spacing))),
                     height / max(1, round(height / (per_pixel**-0.5 * margin_spacing)))])  # fmt: skip
    assert (beyond >= cell / 2 - 1e-6).any(1).all()
    # ... and together they reach every border of the canvas, without going further than a cell beyond it.
    low, high = outer - cell / 2, outer + cell / 2
    size = np.array([width + left + right, height + top + bottom])
    assert (low.min(0) <= np.minimum([left, top], 1e-6)).all()
    assert (high.max(0) >= np.where(np.array([right, bottom]) > 0, size, 0) - 1e-6).all()
    assert (low > -cell - 1e-6).all()
    assert (high < size + cell + 1e-6).all()


@pytest.mark.parametrize("margins", [(0, 0, 0, 0), (16, 8, 24, 0), (13, 5, 3, 7)])
def test_anchors_by_need_keep_the_budget_and_know_where_they_are(margins: tuple[int, int, int, int]) -> None:
    canvas = padded_canvas(64, 48, margins)
    grid = place(canvas, QUADTREE)
    left, top, *_ = margins
    assert 0.9 * 64 * 48 / 4 < len(grid.pixels) <= 64 * 48 / 4
    inside = (
        (grid.pixels[:, 0] >= left)
        & (grid.pixels[:, 0] < left + 64)
        & (grid.pixels[:, 1] >= top)
        & (grid.pixels[:, 1] < top + 48)
    )
    np.testing.assert_array_equal(grid.in_original, inside)
    if any(margins):
        per_pixel = inside.sum() / (64 * 48)
        outside_pixels = canvas.depth.size - 64 * 48
        assert per_pixel > 1.5 * (~inside).sum() / outside_pixels


def test_without_a_margin_every_anchor_belongs_to_the_original() -> None:
    """Also those of the last cells of a side that 8 does not divide, whose centres may lie beyond the picture."""
    grid = place(bare_canvas(picture(41, 33)), QUADTREE)
    assert (grid.pixels.max(0) > [33, 41]).any()
    assert grid.in_original.all()


def test_the_configuration_chooses_the_placement() -> None:
    canvas = bare_canvas(picture(64, 64))
    assert len(np.unique(place(canvas, GRID).spacing)) == 1
    assert len(np.unique(place(canvas, QUADTREE).spacing)) > 1


def test_anchors_project_to_their_pixels_and_have_the_size_of_their_cells() -> None:
    canvas = padded_canvas(40, 30, (7, 3, 0, 5))
    grid = place(canvas, QUADTREE)
    anchors = planar_anchors(canvas, grid, QUADTREE)
    pixels, z = canvas.camera.project(anchors.means.double().numpy())
    np.testing.assert_allclose(pixels, grid.pixels, atol=1e-4)
    np.testing.assert_allclose(z, PLANE_DEPTH, atol=1e-7)
    sigma = torch.exp(0.5 * anchors.log_variances).numpy() * canvas.camera.K[0, 0] / PLANE_DEPTH
    np.testing.assert_allclose(sigma[:, 0], QUADTREE.kappa * grid.spacing, rtol=1e-5)
    np.testing.assert_array_equal(sigma[:, 0], sigma[:, 1])
    np.testing.assert_allclose(sigma[:, 2], QUADTREE.thickness * sigma[:, 0], rtol=1e-5)
    np.testing.assert_array_equal(anchors.rotations().numpy(), np.broadcast_to(np.eye(3), (len(anchors), 3, 3)))
    stage = np.where(grid.in_original, int(Stage.ORIGINAL), int(Stage.OUTPAINTED))
    np.testing.assert_array_equal(anchors.stage.numpy(), stage)


@pytest.mark.parametrize(("kappa", "hits"), [(0.45, 4), (0.5, 5), (0.64, 8), (0.9, 16)])
def test_hits_per_ray_on_a_regular_grid(kappa: float, hits: int) -> None:
    """pi chi2 kappa^2, whatever the number of anchors (METHOD.md 1.1)."""
    canvas = bare_canvas(picture(48, 48), hfov=30)
    config = replace(GRID, kappa=kappa, anchors_per_pixel=0.21)  # off the pixel grid, where the mean is the law's
    anchors = planar_anchors(canvas, regular_grid(canvas, config), config)
    decoders = analytic_decoders(config.density, torch.Generator().manual_seed(0))
    counts = Renderer(anchors, decoders, RenderConfig()).hits(canvas.camera).count.reshape(48, 48)
    assert counts[8:-8, 8:-8].mean() == pytest.approx(hits, rel=0.06)


@pytest.mark.parametrize("config", [GRID, QUADTREE], ids=["grid", "quadtree"])
def test_the_plane_is_opaque_and_at_its_depth(config: PlanarConfig) -> None:
    canvas = bare_canvas(picture(64, 64))
    anchors = planar_anchors(canvas, place(canvas, config), config)
    decoders = analytic_decoders(config.density, torch.Generator().manual_seed(0))
    rendered = Renderer(anchors, decoders, RenderConfig()).render(canvas.camera)
    assert rendered.alpha.min() > 0.97
    np.testing.assert_allclose(rendered.depth, PLANE_DEPTH, atol=0.01)


def test_rest_positions_fill_the_unit_square() -> None:
    canvas = padded_canvas(40, 28, (10, 0, 14, 20))
    grid = place(canvas, QUADTREE)
    rest = rest_positions(canvas, grid).numpy()
    np.testing.assert_allclose(rest, grid.pixels / [64, 48], atol=1e-6)
    assert rest.min() > 0
    assert rest.max() < 1
    assert (rest.max(0) - rest.min(0) > 0.8).all()
