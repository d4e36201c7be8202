"""Pruning: what no view reaches goes, and nothing that is rendered changes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from orca.anchors import GaussianAnchors
from orca.config import PlanarConfig, RenderConfig
from orca.field.decoders import analytic_decoders
from orca.pipeline import reconstruct
from orca.render.renderer import Renderer
from orca.stages.planar import place, planar_anchors
from orca.stages.prune import reached
from tests.orca import repair_scenes
from tests.orca.stage_inputs import bare_canvas, picture, view


def plane() -> GaussianAnchors:
    """Anchors over a picture twice as wide as any view here, of random colours."""
    canvas = bare_canvas(picture(64, 64), hfov=90)
    anchors = planar_anchors(canvas, place(canvas, PlanarConfig()), PlanarConfig())
    anchors.features[:, :3] = torch.randn(len(anchors), 3, generator=torch.Generator().manual_seed(0))
    return anchors


@pytest.mark.parametrize("decode", ["layered", "per_hit"])
def test_the_views_stay_as_they_are(decode: str) -> None:
    anchors, views = plane(), [view(40, 40, 50), view(40, 40, 50, x=0.2), view(40, 40, 40, z=0.3)]
    decoders = analytic_decoders(15.0, torch.Generator().manual_seed(0))
    renderer = Renderer(anchors, decoders, RenderConfig(decode=decode))  # type: ignore[arg-type]
    used = reached(renderer, views)
    assert 0.1 < used.mean() < 0.7
    for camera in views:
        whole, part = renderer.render(camera), renderer.part(used).render(camera)
        np.testing.assert_allclose(part.rgb, whole.rgb, atol=1e-6)
        np.testing.assert_allclose(part.alpha, whole.alpha, atol=1e-6)
        np.testing.assert_allclose(part.depth, whole.depth, atol=1e-6)


def test_every_anchor_that_a_ray_hits_is_kept() -> None:
    renderer = Renderer(plane(), analytic_decoders(15.0, torch.Generator().manual_seed(0)), RenderConfig())
    camera = view(40, 40, 50, x=0.1)
    hit = np.unique(renderer.hits(camera).anchor)
    used = reached(renderer, [camera])
    assert used[hit].all()
    assert used.sum() < 1.3 * len(hit)  # ... and little else


def test_more_views_use_no_fewer_anchors_and_no_view_uses_none() -> None:
    renderer = Renderer(plane(), analytic_decoders(15.0, torch.Generator().manual_seed(0)), RenderConfig())
    one, two = reached(renderer, [view(40, 40, 30)]), reached(renderer, [view(40, 40, 30), view(40, 40, 30, x=0.5)])
    assert (two | ~one).all()
    assert two.sum() > one.sum()
    assert not reached(renderer, []).any()


def test_pruned_scenes_show_what_whole_ones_show() -> None:
    """The whole method, repairs included."""
    image, depth = repair_scenes.picture()
    config, views = repair_scenes.small_config(), repair_scenes.sideways(0.12)
    pruned, whole = (
        reconstruct(
            image, repair_scenes.input_camera(), repair_scenes.estimate(depth), views, replace(config, prune=prune)
        )
        for prune in (True, False)
    )
    assert pruned.record["pruned"] == whole.scene.num_anchors - pruned.scene.num_anchors
    assert "pruned" not in whole.record
    for camera in views:
        np.testing.assert_allclose(
            pruned.scene.renderer().render(camera).rgb, whole.scene.renderer().render(camera).rgb, atol=1e-6
        )


def test_a_path_around_a_corner_prunes_the_corner() -> None:
    """Views look past the right side and past the top, none past both: what sits in that corner of the canvas goes.

    The views that the path has stay the same; a view into the corner does not.
    """
    image, depth = repair_scenes.picture()
    views = (repair_scenes.input_camera(), view(64, 64, 60, x=0.3), view(64, 64, 60, y=-0.3))
    pruned, whole = (
        reconstruct(
            image,
            repair_scenes.input_camera(),
            repair_scenes.estimate(depth),
            views,
            replace(repair_scenes.small_config(), prune=prune),
        )
        for prune in (True, False)
    )
    assert pruned.record["margins"][0] == pruned.record["margins"][3] == 0 < min(pruned.record["margins"][1:3])
    assert pruned.record["pruned"] > 0
    assert pruned.record["pruned"] == whole.scene.num_anchors - pruned.scene.num_anchors
    assert [r["area"] for r in pruned.ledger["repairs"]] == [r["area"] for r in whole.ledger["repairs"]]
    before, after = whole.scene.renderer(), pruned.scene.renderer()
    for camera in views:
        np.testing.assert_allclose(after.render(camera).rgb, before.render(camera).rgb, atol=1e-6)
        np.testing.assert_allclose(after.render(camera).alpha, before.render(camera).alpha, atol=1e-6)
    corner = view(64, 64, 60, x=0.3, y=-0.3)
    assert after.render(corner).alpha.mean() < before.render(corner).alpha.mean() - 0.002
