"""Selection and rendering in torch operations, the path of CUDA, held to the compiled ones."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from orca.config import RenderConfig
from orca.field.decoders import Decoders
from orca.render.expand import expand_hits
from orca.render.renderer import Renderer
from orca.render.selector import select
from tests.orca.anchor_scenes import random_anchors, random_camera

SCENES = {
    "flat and round": (0, 250, 61, 43, (0.01, 0.25), (0.3, 6.0)),
    "needles": (1, 250, 53, 71, (0.002, 0.6), (0.5, 5.0)),
    "around the camera": (3, 150, 40, 48, (0.05, 0.5), (0.01, 1.5)),
}


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("most", [1000, 2])
def test_hits_are_those_of_the_compiled_selection(name: str, most: int) -> None:
    seed, n, width, height, extents, depths = SCENES[name]
    camera = random_camera(seed, width, height)
    anchors = random_anchors(seed, n, camera, extents, depths)
    config = RenderConfig(max_hits=most)
    hits, overflow = expand_hits(anchors, camera, config)
    expected = select(anchors, camera, config)
    ray, anchor = expected.flat(np.arange(width * height))
    assert len(ray) > 500
    np.testing.assert_array_equal(hits.ray.numpy(), ray)
    np.testing.assert_array_equal(hits.anchor.numpy(), anchor)
    assert overflow == expected.overflow
    assert (overflow > 0) == (most == 2)


@pytest.mark.parametrize(
    "config",
    [RenderConfig(), RenderConfig(decode="per_hit", window=2), RenderConfig(decode="per_hit", window=-1)],
    ids=["layered", "window", "whole layer"],
)
def test_images_are_those_of_the_compiled_renderer(config: RenderConfig) -> None:
    seed, n, width, height, extents, depths = SCENES["flat and round"]
    camera = random_camera(seed, width, height)
    anchors = random_anchors(seed, n, camera, extents, depths)
    decoders = Decoders(use_direction=True, generator=torch.Generator().manual_seed(0))
    fast = Renderer(anchors, decoders, config).render(camera)
    flat = Renderer(anchors, decoders, config, backend="torch").render(camera)
    np.testing.assert_allclose(flat.rgb, fast.rgb, atol=1e-4)
    np.testing.assert_allclose(flat.alpha, fast.alpha, atol=1e-4)
    assert fast.alpha.max() > 0.5


def test_no_hit_at_all_is_an_empty_image() -> None:
    camera = random_camera(0, 20, 10)
    behind = random_anchors(0, 5, camera, (0.01, 0.02), (1.0, 2.0)).subset(torch.arange(0))
    view = Renderer(behind, Decoders(generator=torch.Generator().manual_seed(0)), RenderConfig(), backend="torch")
    assert not view.render(camera).alpha.any()
