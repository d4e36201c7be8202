"""The closed-form fit against an independent float64 optimum, and against the renderer whose system it solves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse
import torch
from scipy.sparse.linalg import lsqr

from orca.anchors import GaussianAnchors
from orca.config import DeformConfig, PlacementConfig, PlanarConfig, RenderConfig, get_preset
from orca.field.decoders import COLOUR_CHANNELS, analytic_decoders
from orca.priors.outpaint import MirrorOutpainter, extend_depth
from orca.render.renderer import Renderer
from orca.render.selector import select_brute_force
from orca.stages.canvas import Canvas
from orca.stages.deform import deform
from orca.stages.forward import forward
from orca.stages.linear import linear_view
from orca.stages.observations import Observation, observations
from orca.stages.planar import place, planar_anchors
from orca.stages.solve import solve, solve_colours
from tests.orca.stage_inputs import bare_canvas, picture, psnr, view

GRID = PlanarConfig(placement=PlacementConfig(kind="grid"))
LAYERED = RenderConfig()
DECODING = {
    "layered": LAYERED,
    "per hit, window 2": RenderConfig(decode="per_hit", window=2),
    "per hit, window 0": RenderConfig(decode="per_hit", window=0),
    "per hit, whole layer": RenderConfig(decode="per_hit", window=-1),
}


def prepared(canvas: Canvas, config: PlanarConfig) -> tuple[GaussianAnchors, tuple[Observation, ...]]:
    return planar_anchors(canvas, place(canvas, config), config), observations(canvas, 4.0)


def fitted(canvas: Canvas, config: PlanarConfig, render: RenderConfig = LAYERED) -> tuple[GaussianAnchors, float]:
    """Solved anchors, and how well their rendering reproduces the original."""
    anchors, observed = prepared(canvas, config)
    decoders = analytic_decoders(config.density, torch.Generator().manual_seed(0))
    solved = solve_colours(anchors, decoders, observed, config, render)
    rendered = Renderer(solved, decoders, render).render(observed[0].camera)
    return solved, psnr(rendered.rgb, canvas.image[canvas.original])


def optimum(canvas: Canvas, config: PlanarConfig) -> float:
    """PSNR of the least-squares solution of W c = I, W from brute-force selection, all in float64."""
    anchors, _ = prepared(canvas, config)
    hits = select_brute_force(anchors, canvas.camera, LAYERED)
    e = np.exp(-0.5 * hits.m2.astype(np.float64))
    ray = np.repeat(np.arange(hits.num_rays), hits.count)
    weight = e / np.bincount(ray, e, hits.num_rays)[ray]
    W = scipy.sparse.csr_matrix((weight, (ray, hits.anchor)), (hits.num_rays, len(anchors)))
    image = canvas.image.reshape(-1, 3).astype(np.float64)
    best = np.stack([W @ lsqr(W, image[:, c], atol=1e-9, btol=1e-9, iter_lim=500)[0] for c in range(3)], 1)
    return psnr(best, image)


@pytest.mark.parametrize(("size", "per_pixel"), [(64, 0.25), (40, 0.5)])
def test_the_fit_reaches_the_least_squares_optimum(size: int, per_pixel: float) -> None:
    canvas, config = bare_canvas(picture(size, size)), replace(GRID, anchors_per_pixel=per_pixel)
    _, reached = fitted(canvas, config)
    assert reached == pytest.approx(optimum(canvas, config), abs=0.3)


def test_one_anchor_per_pixel_interpolates() -> None:
    _, reached = fitted(bare_canvas(picture(64, 64)), replace(GRID, anchors_per_pixel=1.0))
    assert reached > 45


def test_placement_by_need_beats_the_regular_grid() -> None:
    image = np.full((64, 64, 3), 0.5, np.float32)
    image[8:40, 8:40] = picture(64, 64)[8:40, 8:40]
    _, by_need = fitted(bare_canvas(image), PlanarConfig())
    _, regular = fitted(bare_canvas(image), GRID)
    assert by_need > regular + 3


@pytest.mark.parametrize("render", DECODING.values(), ids=DECODING.keys())
def test_the_linear_view_is_what_the_renderer_shows(render: RenderConfig) -> None:
    """gather . sigmoid(weights . c) = the rendering, on overlapping surfaces at two depths seen from the side."""
    camera = view(40, 40)
    depth = np.full((40, 40), 2.0, np.float32)
    depth[10:30, 10:30] = 1.2
    anchors, _ = prepared(bare_canvas(picture(40, 40), depth), GRID)
    anchors = deform(anchors, depth, camera, DeformConfig())
    anchors.features[:, :COLOUR_CHANNELS] = torch.randn(len(anchors), 3, generator=torch.Generator().manual_seed(1))
    renderer = Renderer(anchors, analytic_decoders(6.0, torch.Generator().manual_seed(0)), render)
    side = view(40, 40, x=0.25)
    system = linear_view(renderer, Observation(side, np.arange(1600), np.zeros((1600, 3), np.float32)))
    seen = forward(system, anchors.features[:, :COLOUR_CHANNELS].numpy()).seen
    np.testing.assert_allclose(seen, renderer.render(side).rgb.reshape(-1, 3), atol=2e-5)


def test_a_view_of_some_rays_is_those_rows_of_the_whole() -> None:
    anchors, (observation,) = prepared(bare_canvas(picture(24, 24)), GRID)
    renderer = Renderer(anchors, analytic_decoders(15.0, torch.Generator().manual_seed(0)), LAYERED)
    chosen = np.array([5, 3, 500, 77])
    x = np.random.default_rng(0).normal(size=(len(anchors), 3)).astype(np.float32)

    def shown(rays: np.ndarray) -> np.ndarray:
        part = linear_view(renderer, Observation(observation.camera, rays, observation.colour[rays]))
        return forward(part, x).seen

    np.testing.assert_allclose(shown(chosen), shown(observation.rays)[chosen], atol=1e-6)


@pytest.mark.parametrize("name", ["per hit, window 2", "per hit, whole layer"])
def test_per_hit_decoding_is_solved_as_well(name: str) -> None:
    canvas = bare_canvas(picture(48, 48))
    _, layered = fitted(canvas, GRID)
    _, per_hit = fitted(canvas, GRID, DECODING[name])
    assert per_hit > layered - 1.2


def test_the_margin_is_fitted_without_hurting_the_original() -> None:
    image = picture(48, 64)
    margins = (24, 8, 16, 12)
    canvas = Canvas(
        MirrorOutpainter().outpaint(image, *margins),
        extend_depth(np.ones((48, 64), np.float32), *margins),
        view(64, 48).padded(*margins),
        margins,
    )
    canvas.image[canvas.original] = image
    solved, with_margin = fitted(canvas, GRID)
    _, alone = fitted(bare_canvas(image), GRID)
    assert with_margin > alone - 0.3
    decoders = analytic_decoders(GRID.density, torch.Generator().manual_seed(0))
    whole = Renderer(solved, decoders, LAYERED).render(canvas.camera)
    outside = np.ones(canvas.depth.shape, bool)
    outside[canvas.original] = False
    assert psnr(whole.rgb[outside], canvas.image[outside]) > 25


def test_black_and_white_stay_within_the_clip() -> None:
    image = np.zeros((32, 32, 3), np.float32)
    image[:, 16:] = 1.0
    solved, reached = fitted(bare_canvas(image), replace(GRID, anchors_per_pixel=1.0))
    assert reached > 35
    limit = 2 * np.log((1 - GRID.colour_clip) / GRID.colour_clip)
    assert float(solved.features[:, :3].abs().max()) <= limit + 1e-4


def test_solving_again_starts_from_what_the_anchors_carry() -> None:
    canvas = bare_canvas(picture(48, 48))
    anchors, observed = prepared(canvas, GRID)
    decoders = analytic_decoders(GRID.density, torch.Generator().manual_seed(0))
    short = replace(GRID, gauss_newton_steps=1, cg_steps=1)
    scores, current = [], anchors
    for _ in range(4):
        current = solve_colours(current, decoders, observed, short, LAYERED)
        scores.append(psnr(Renderer(current, decoders, LAYERED).render(canvas.camera).rgb, canvas.image))
    assert all(b > a for a, b in pairwise(scores))
    assert scores[-1] > scores[0] + 0.2


def test_only_colours_change_and_nothing_is_drawn_at_random() -> None:
    canvas = bare_canvas(picture(32, 32))
    anchors, _ = prepared(canvas, GRID)
    (first, _), (second, _) = fitted(canvas, GRID), fitted(canvas, GRID)
    assert torch.equal(first.features, second.features)
    assert torch.equal(first.features[:, COLOUR_CHANNELS:], anchors.features[:, COLOUR_CHANNELS:])
    for name in ("means", "log_variances", "quaternions", "opacity_logits", "stage"):
        assert torch.equal(getattr(first, name), getattr(anchors, name))


def test_an_anchor_that_no_pixel_sees_stays_where_it_is() -> None:
    canvas = bare_canvas(picture(32, 32))
    anchors, observed = prepared(canvas, GRID)
    behind = replace(anchors.subset(torch.arange(3)), means=-anchors.means[:3])
    both = GaussianAnchors.concatenate(anchors, behind)
    decoders = analytic_decoders(GRID.density, torch.Generator().manual_seed(0))
    solved = solve_colours(both, decoders, observed, GRID, LAYERED)
    assert torch.equal(solved.features[-3:, :3], torch.zeros(3, 3))
    assert torch.isfinite(solved.features).all()


# --- real pictures --------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.data
@pytest.mark.parametrize(("scene", "regular_grid_optimum"), [("bear", 32.7), ("lavender", 38.9)])
def test_draft_beats_the_regular_grids_optimum(
    data_root: Path, scene: str, regular_grid_optimum: float, record_property: Callable[[str, object], None]
) -> None:
    """METHOD.md 1.2: PSNR of the best possible fit with 65,536 anchors on a regular grid."""
    from bench.datasets.realmdreamer import RealmDreamer

    case = RealmDreamer(data_root).load(scene)
    preset = get_preset("draft")
    canvas = Canvas(case.image.astype(np.float32) / 255, case.depth, case.camera, (0, 0, 0, 0))
    solved, reached = fitted(canvas, preset.planar, preset.render)
    record_property("psnr_db", reached)
    assert 65_000 < len(solved) <= 65_536
    assert reached >= regular_grid_optimum


def test_what_rays_lack_is_the_gradient_by_the_samples() -> None:
    """Against finite differences of the squared error, two layers deep."""
    camera = view(12, 12)
    depth = np.full((12, 12), 2.0, np.float32)
    depth[3:9, 3:9] = 1.2
    anchors, (observation,) = prepared(bare_canvas(picture(12, 12), depth), GRID)
    anchors = deform(anchors, depth, camera, DeformConfig())
    system = linear_view(
        Renderer(anchors, analytic_decoders(6.0, torch.Generator().manual_seed(0)), LAYERED), observation
    )
    x = np.random.default_rng(0).normal(size=(len(anchors), 3)).astype(np.float32)
    gradient = system.weights.transposed_times(forward(system, x).missing)

    def half_error(logits: np.ndarray) -> float:
        seen = forward(system, logits.astype(np.float32)).seen.astype(np.float64)
        return 0.5 * float(np.square(seen - system.target).sum())

    for anchor, channel in ((5, 0), (14, 1), (21, 2), (35, 0)):
        step = np.zeros_like(x)
        step[anchor, channel] = 1e-2
        slope = (half_error(x + step) - half_error(x - step)) / 2e-2
        assert -gradient[anchor, channel] == pytest.approx(slope, abs=2e-4, rel=2e-2)


def test_it_says_how_well_it_began_and_ended() -> None:
    anchors, observed = prepared(bare_canvas(picture(32, 32)), GRID)
    decoders = analytic_decoders(15.0, torch.Generator().manual_seed(0))
    found = solve(anchors, decoders, observed, GRID, LAYERED)
    again = solve(found.anchors, decoders, observed, GRID, LAYERED)
    assert found.after > found.before + 3
    assert again.before == pytest.approx(found.after, abs=1e-6)
    shown = Renderer(found.anchors, decoders, LAYERED).render(observed[0].camera).rgb
    assert psnr(np.clip(shown, 0, 1).reshape(-1, 3), observed[0].colour) == pytest.approx(found.after, abs=1e-2)
