"""Growth by residual: where it adds anchors, when it stops, and what it says then."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orca.config import GrowthConfig, PlacementConfig, PlanarConfig, RenderConfig, get_preset
from orca.errors import BadInput
from orca.pipeline import reconstruct
from orca.stages.canvas import Canvas
from orca.stages.growth import Growth, grow
from orca.stages.observations import observations
from orca.stages.placement import Cells, cell_of_pixel, quadtree, split_cells
from orca.stages.planar import planar_anchors, tree_by_need
from tests.orca import repair_scenes
from tests.orca.stage_inputs import bare_canvas, picture, psnr

PLANAR = PlanarConfig()


def grown(canvas: Canvas, **limits: float) -> Growth:
    config = GrowthConfig(**limits)  # type: ignore[arg-type]
    return grow(
        canvas,
        observations(canvas, 4.0),
        lambda grid: planar_anchors(canvas, grid, PLANAR),
        PLANAR,
        RenderConfig(),
        config,
    )


def spotted() -> Canvas:
    """A smooth slope with one square of noise."""
    y, x = np.mgrid[0:64, 0:64] / 64
    image = np.stack([0.2 + 0.4 * x, 0.3 + 0.3 * y, 0.5 + 0 * x], 2).astype(np.float32)
    image[8:32, 8:32] = picture(64, 64)[8:32, 8:32]
    return bare_canvas(image)


@settings(max_examples=30, deadline=None)
@given(st.integers(16, 60), st.integers(16, 60), st.integers(0, 1000), st.floats(0, 1))
def test_split_cells_cover_every_pixel_once_and_inherit(height: int, width: int, seed: int, share: float) -> None:
    random = np.random.default_rng(seed)
    ones = np.ones((height, width), np.float32)
    cells = quadtree(picture(height, width, seed), ones, ones, height * width // 6, PlacementConfig())
    which = (random.random(len(cells.sizes)) < share) & (cells.sizes > 1)
    finer, origin = split_cells(cells, which, width, height)
    before, after = cell_of_pixel(cells, width, height), cell_of_pixel(finer, width, height)
    np.testing.assert_array_equal(origin[after], before)
    np.testing.assert_array_equal(np.unique(after), np.arange(len(finer.sizes)))
    y, x = np.mgrid[0:height, 0:width] + 0.5
    distance = np.maximum(abs(finer.centres[after, 0] - x), abs(finer.centres[after, 1] - y))
    assert (distance <= finer.sizes[after] / 2).all()
    assert np.isin(finer.sizes[~np.isin(origin, np.flatnonzero(which))], cells.sizes).all()


def test_four_quarters_worked_by_hand() -> None:
    cells = Cells(np.array([[4.0, 4.0], [12.0, 4.0]]), np.array([8.0, 8.0]))
    finer, origin = split_cells(cells, np.array([False, True]), 14, 8)
    # The right cell's quarters begin at x = 8 and 12; all reach into a picture 14 pixels wide.
    np.testing.assert_array_equal(finer.centres, [[4, 4], [10, 2], [14, 2], [10, 6], [14, 6]])
    np.testing.assert_array_equal(finer.sizes, [8, 4, 4, 4, 4])
    np.testing.assert_array_equal(origin, [0, 1, 1, 1, 1])
    narrow, origin = split_cells(cells, np.array([False, True]), 12, 8)
    np.testing.assert_array_equal(narrow.centres, [[4, 4], [10, 2], [10, 6]])
    np.testing.assert_array_equal(origin, [0, 1, 1])


def test_anchors_go_where_the_error_is() -> None:
    canvas = spotted()
    growth = grown(canvas, max_anchors=1200)
    spot = ((growth.grid.pixels > 6) & (growth.grid.pixels < 34)).all(1)
    assert spot.mean() > 0.5  # of anchors, on 18 % of the picture
    assert growth.grid.spacing[spot].mean() < 0.5 * growth.grid.spacing[~spot].mean()


def test_it_grows_to_the_count_and_every_round_gains() -> None:
    growth = grown(spotted(), max_anchors=1000)
    counts, scores = [s.anchors for s in growth.steps], [s.psnr_db for s in growth.steps]
    assert growth.stopped == "reached 1000 anchors"
    assert 997 < counts[-1] <= 1000
    assert len(growth.grid.pixels) == len(growth.colours) == counts[-1]
    assert all(b > a for a, b in pairwise(counts))
    assert scores[-1] > scores[0] + 3


def test_it_stops_at_the_target_and_not_long_after() -> None:
    free = grown(spotted(), max_anchors=1500)
    target = free.steps[0].psnr_db
    growth = grown(spotted(), target_psnr=target)
    assert growth.stopped == f"reached {target:g} dB"
    assert growth.steps[-1].psnr_db >= target > growth.steps[-2].psnr_db
    assert growth.steps[-1].anchors < free.steps[-1].anchors


def test_a_price_stops_where_a_thousand_anchors_gain_less() -> None:
    growth = grown(spotted(), price=10.0)
    assert "less than their price of 10" in growth.stopped
    rates = [(b.psnr_db - a.psnr_db) / (b.anchors - a.anchors) * 1000 for a, b in pairwise(growth.steps)]
    assert rates[-1] < 10
    assert all(rate >= 10 for rate in rates[:-1])


def test_a_higher_price_buys_no_more_anchors() -> None:
    counts = [grown(spotted(), price=price).steps[-1].anchors for price in (5.0, 10.0, 20.0)]
    assert counts == sorted(counts, reverse=True)


def test_without_a_count_it_ends_when_nothing_is_left_to_split_or_to_gain() -> None:
    growth = grown(bare_canvas(picture(24, 24)), target_psnr=200.0)
    assert growth.stopped in ("every cell with an error is one pixel", "4 rounds gained less than 0.03 dB")
    assert growth.steps[-1].psnr_db > 40


def test_what_it_says_is_what_is_shown() -> None:
    """The PSNR of the last round is the PSNR of the rendering of what it hands back."""
    import torch

    from orca.field.decoders import analytic_decoders
    from orca.render.renderer import Renderer
    from orca.stages.solve import with_colours

    canvas = spotted()
    growth = grown(canvas, max_anchors=900)
    anchors = with_colours(planar_anchors(canvas, growth.grid, PLANAR), growth.colours)
    decoders = analytic_decoders(PLANAR.density, torch.Generator().manual_seed(0))
    shown = Renderer(anchors, decoders, RenderConfig()).render(canvas.camera).rgb
    assert psnr(np.clip(shown, 0, 1), canvas.image) == pytest.approx(growth.steps[-1].psnr_db, abs=0.01)


def test_what_a_part_of_the_rays_says_is_confirmed_by_all() -> None:
    """The first fit looks at one ray of four in coarse cells; detail that those rays miss does not count as reached."""
    image = np.full((64, 64, 3), 0.4, np.float32)
    image[33::8, 33::8] = 0.9  # odd places: a thinned fit sees none of them
    canvas = bare_canvas(image)
    target = psnr(np.full_like(image, 0.4), image) + 3
    growth = grown(canvas, target_psnr=target)
    assert growth.stopped == f"reached {target:g} dB"
    assert (growth.grid.spacing < 8).any()
    even = grown(bare_canvas(np.full((64, 64, 3), 0.4, np.float32)), target_psnr=40.0)
    assert [s.anchors for s in even.steps] == [64]


def test_it_starts_near_the_end() -> None:
    """The quadtree's own error predicts how many anchors a target takes, so few rounds are left."""
    canvas = bare_canvas(picture(96, 96))
    for target in (28.0, 32.0, 36.0):
        growth = grown(canvas, target_psnr=target)
        assert growth.stopped == f"reached {target:g} dB"
        assert len(growth.steps) <= 4
        assert growth.steps[0].anchors < growth.steps[-1].anchors or len(growth.steps) == 1


def test_rounds_to_a_count_are_alike() -> None:
    counts = [s.anchors for s in grown(bare_canvas(picture(64, 64)), max_anchors=1500).steps]
    ratios = [b / a for a, b in pairwise(counts)]
    assert counts[0] == pytest.approx(1050, abs=3)
    assert len(ratios) == 3
    assert max(ratios) - min(ratios) < 0.02
    assert max(ratios) <= 1.15


def test_grown_anchors_beat_as_many_placed_at_once() -> None:
    canvas = bare_canvas(picture(64, 64))
    import torch

    from orca.field.decoders import analytic_decoders
    from orca.render.renderer import Renderer
    from orca.stages.planar import place
    from orca.stages.solve import solve_colours

    at_once = planar_anchors(canvas, place(canvas, PLANAR), PLANAR)
    decoders = analytic_decoders(PLANAR.density, torch.Generator().manual_seed(0))
    solved = solve_colours(at_once, decoders, observations(canvas, 4.0), PLANAR, RenderConfig())
    placed = psnr(Renderer(solved, decoders, RenderConfig()).render(canvas.camera).rgb, canvas.image)
    assert grown(canvas, max_anchors=len(at_once)).steps[-1].psnr_db > placed


def test_twice_the_same() -> None:
    first, second = (grown(spotted(), max_anchors=800) for _ in range(2))
    np.testing.assert_array_equal(first.grid.pixels, second.grid.pixels)
    np.testing.assert_array_equal(first.colours, second.colours)


def test_the_margin_starts_from_coarser_cells_away_from_frame_and_depth_edges() -> None:
    depth = np.ones((128, 128), np.float32)
    depth[:, 112:] = 2.0
    canvas = Canvas(np.full((128, 128, 3), 0.5, np.float32), depth, repair_scenes.input_camera().padded(32, 32, 32, 32),
                    (32, 32, 32, 32))  # fmt: skip
    cells = tree_by_need(canvas, PlacementConfig(margin_cell=16)).cells(2000)
    size = cells.sizes[cell_of_pixel(cells, 128, 128)]
    assert (size[:16, :96] == 16).all()
    assert (size[16:32, 16:96] == 8).all()  # beside the frame
    assert (size[32:96, 32:96] <= 8).all()
    assert (size[:, 111:113] <= 8).all()


def test_the_margin_grows_with_the_quality_asked_for() -> None:
    camera = repair_scenes.input_camera().padded(32, 32, 32, 32)
    canvas = Canvas(picture(128, 128), np.ones((128, 128), np.float32), camera, (32, 32, 32, 32))
    inside, outside = [], []
    for target in (20.0, 30.0):
        pixels = grown(canvas, target_psnr=target).grid.pixels
        within = ((pixels >= 32) & (pixels < 96)).all(1)
        inside.append(int(within.sum()))
        outside.append(int((~within).sum()))
    assert inside[1] > 1.3 * inside[0]
    assert outside[1] > 1.1 * outside[0]


@pytest.mark.parametrize("limits", [{"target_psnr": 0.0}, {"max_anchors": -5}, {"price": float("nan")}])
def test_limits_that_make_no_sense_are_refused(limits: dict[str, float]) -> None:
    with pytest.raises(BadInput, match="positive, finite"):
        GrowthConfig(**limits)  # type: ignore[arg-type]


def test_too_few_anchors_are_refused_with_how_many_it_takes() -> None:
    with pytest.raises(BadInput, match="64 or more"):
        grown(spotted(), max_anchors=10)


def test_the_pipeline_grows_when_asked_and_says_why_it_stopped() -> None:
    image, depth = repair_scenes.picture()
    config = repair_scenes.small_config()
    config = replace(config, growth=GrowthConfig(price=3.0, max_anchors=2500))
    result = reconstruct(
        image, repair_scenes.input_camera(), repair_scenes.estimate(depth), repair_scenes.sideways(0.12), config
    )
    growth = json.loads(json.dumps(result.record["growth"]))
    assert growth["stopped"]
    placed = result.record["anchors"]["original"] + result.record["anchors"]["outpainted"] + result.record["pruned"]
    assert growth["curve"][-1]["anchors"] == placed
    assert [set(row) for row in growth["curve"]] == [{"anchors", "psnr"}] * len(growth["curve"])


def test_presets_grow_to_their_count_inside_the_image() -> None:
    image, depth = repair_scenes.picture()
    config = repair_scenes.small_config()
    config = replace(config, planar=replace(config.planar, anchors_per_pixel=0.25))
    result = reconstruct(
        image, repair_scenes.input_camera(), repair_scenes.estimate(depth), repair_scenes.sideways(0.12), config
    )
    count = image.shape[0] * image.shape[1] // 4
    stopped = ("every cell with an error is one pixel", f"reached {count} anchors inside the image")
    assert result.record["growth"]["stopped"] in stopped
    assert result.record["anchors"]["original"] <= count
    assert result.record["input_psnr"]["planar"] == result.record["growth"]["curve"][-1]["psnr"]
    assert PlacementConfig().kind == get_preset("quality").planar.placement.kind == "growth"


@pytest.mark.parametrize("kind", ["quadtree", "grid"])
def test_other_placements_are_at_once(kind: str) -> None:
    image, depth = repair_scenes.picture()
    config = repair_scenes.small_config()
    placement = replace(config.planar.placement, kind=kind)
    config = replace(config, planar=replace(config.planar, placement=placement, anchors_per_pixel=0.25))
    result = reconstruct(
        image, repair_scenes.input_camera(), repair_scenes.estimate(depth), repair_scenes.sideways(0.12), config
    )
    assert result.record["growth"] == {"stopped": "the preset's count, placed at once", "curve": []}
    assert set(result.record["input_psnr"]) == {"planar", "deformed", "fine_tuned", "final"}


def test_growth_needs_the_closed_form() -> None:
    image, depth = repair_scenes.picture()
    config = replace(get_preset("paper"), growth=GrowthConfig(price=1.0))
    with pytest.raises(BadInput, match="gradient descent"):
        reconstruct(
            image, repair_scenes.input_camera(), repair_scenes.estimate(depth), repair_scenes.sideways(0.1), config
        )
