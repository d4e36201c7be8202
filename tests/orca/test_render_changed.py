"""What is rendered again after anchors are added: every pixel that they reach, as in a whole render, and no other."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from orca.config import RenderConfig
from orca.render.changed import render_changed
from orca.render.renderer import Renderer
from orca.render.rows import SharedRows
from orca.render.tiles import TILE, changed_tiles, reaching
from tests.orca.anchor_scenes import random_anchors, random_camera, random_decoders

CAMERA = random_camera(5, 90, 70)


@pytest.mark.parametrize("backend", ["compiled", "torch"])
@pytest.mark.parametrize("decode", ["layered", "per_hit"])
@pytest.mark.parametrize("use_direction", [False, True])
def test_a_brought_up_to_date_view_is_a_whole_render(
    backend: Literal["compiled", "torch"], decode: Literal["layered", "per_hit"], use_direction: bool
) -> None:
    anchors = random_anchors(5, 300, CAMERA, (0.02, 0.3), (0.8, 5.0))
    decoders = random_decoders(5, use_direction)
    config = replace(RenderConfig(), decode=decode, background=0.25)
    old, new = anchors.subset(torch.arange(292)), anchors.subset(torch.arange(292, 300))
    scene, more = (Renderer(part, decoders, config, backend=backend) for part in (old, new))
    view = scene.render(CAMERA)
    before = view.rgb.copy()
    changed = render_changed(scene, more, CAMERA, scene.boxes(CAMERA), more.boxes(CAMERA))
    changed.write_to(view)
    whole = scene.extended(more).render(CAMERA)
    np.testing.assert_allclose(view.rgb, whole.rgb, atol=1e-5)
    np.testing.assert_allclose(view.alpha, whole.alpha, atol=1e-5)
    np.testing.assert_allclose(view.depth, whole.depth, atol=1e-4)
    assert np.abs(before - whole.rgb).max() > 0.01
    if backend == "compiled":
        hits = more.hits(CAMERA).count > 0
        np.testing.assert_array_equal(changed.pixel, np.flatnonzero(hits))


def test_anchors_out_of_sight_change_nothing() -> None:
    anchors, decoders = random_anchors(1, 50, CAMERA), random_decoders(1, False)
    behind = replace(
        anchors,
        means=anchors.means
        + 100 * torch.from_numpy(CAMERA.center - CAMERA.unproject(np.array([[45.0, 35.0]]), np.ones(1))[0]).float(),
    )
    scene, more = (Renderer(part, decoders, RenderConfig()) for part in (anchors, behind))
    changed = render_changed(scene, more, CAMERA, scene.boxes(CAMERA), more.boxes(CAMERA))
    assert len(changed.pixel) == 0
    assert changed.rgb.shape == (0, 3)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**31), st.integers(0, 30), st.integers(0, 30))
def test_tiles_and_boxes_that_meet(seed: int, changing: int, others: int) -> None:
    rng, size = np.random.default_rng(seed), (75, 100)
    corner = rng.integers(0, 70, (changing + others, 2))
    boxes = np.concatenate([corner, np.minimum(corner + rng.integers(0, 40, corner.shape), size)], 1).astype(np.int32)
    tiles = changed_tiles(boxes[:changing], size)
    y, x = np.mgrid[0 : size[1], 0 : size[0]]
    tile = y // TILE * -(-size[0] // TILE) + x // TILE
    expected = np.zeros(len(tiles), bool)
    for x0, y0, x1, y1 in boxes[:changing]:
        expected[tile[y0:y1, x0:x1]] = True
    np.testing.assert_array_equal(tiles, expected)
    meets = [bool(expected[tile[y0:y1, x0:x1]].any()) for x0, y0, x1, y1 in boxes]
    np.testing.assert_array_equal(reaching(boxes, tiles, size), np.flatnonzero(meets))


def test_rows_share_memory_and_keep_what_they_were() -> None:
    first = np.arange(10.0).reshape(5, 2)
    rows, six = SharedRows(first).extended(5, np.full((1, 2), 6.0))
    same, seven = rows.extended(6, np.full((1, 2), 7.0))
    assert same is rows
    assert np.shares_memory(six, seven)
    other, branch = rows.extended(6, np.full((1, 2), 8.0))  # something else follows row 6 by now
    assert other is not rows
    assert not np.shares_memory(branch, seven)
    np.testing.assert_array_equal(seven[:, 0], [0, 2, 4, 6, 8, 6, 7])
    np.testing.assert_array_equal(branch[:, 0], [0, 2, 4, 6, 8, 6, 8])
    np.testing.assert_array_equal(first, np.arange(10.0).reshape(5, 2))
    assert not np.shares_memory(first, six)
