"""What the deformation leaves at a depth edge: nothing between foreground and background, also seen from the side."""

from __future__ import annotations

from dataclasses import replace

import cv2
import pytest
import torch

from orca.anchors import Stage
from orca.pipeline import reconstruct
from orca.priors.depth import DepthEstimate
from orca.repair.detect import disocclusion_mask
from orca.scene import Scene
from tests.orca.repair_scenes import FAR, NEAR, input_camera, picture, sideways, small_config

BETWEEN = (1.12 * NEAR, FAR / 1.12)  # what is nearer to one of them is that surface: `DeformConfig.edge_ratio`
SIDE = sideways(0.15, 2)[1]


def lifted(sharpen: bool) -> Scene:
    """The square before the wall, from an estimated depth whose edges are soft; nothing is repaired."""
    image, depth = picture()
    soft = cv2.blur(depth, (7, 7))
    config = small_config()
    config = replace(
        config,
        deform=replace(config.deform, sharpen_depth=sharpen),
        repair=replace(config.repair, enabled=False),
    )
    return reconstruct(image, input_camera(), DepthEstimate(soft, "soft", True), (SIDE,), config).scene


@pytest.fixture(scope="module")
def sharpened() -> Scene:
    return lifted(True)


@pytest.fixture(scope="module")
def soft() -> Scene:
    return lifted(False)


def mass_between(scene: Scene) -> float:
    """Share of the opacity of the original's anchors that lies between the two surfaces."""
    inner = scene.anchors.stage == int(Stage.ORIGINAL)
    z, opacity = scene.anchors.means[inner, 2], torch.sigmoid(scene.anchors.opacity_logits[inner])
    return float(opacity[(z > BETWEEN[0]) & (z < BETWEEN[1])].sum() / opacity.sum())


def seen_between(scene: Scene) -> int:
    """Pixels of the side view that show something between the two surfaces."""
    view = scene.renderer().render(SIDE)
    return int(((view.alpha > 0.5) & (view.depth > BETWEEN[0]) & (view.depth < BETWEEN[1])).sum())


def test_no_opacity_between_foreground_and_background(sharpened: Scene, soft: Scene) -> None:
    assert mass_between(sharpened) == 0.0
    assert mass_between(soft) > 0.1  # what the test would see


def test_from_the_side_the_gap_is_open(sharpened: Scene, soft: Scene) -> None:
    assert seen_between(sharpened) <= 24  # a pixel in each row of the square's edge is half square and half wall
    assert seen_between(soft) > 200
    view = sharpened.renderer().render(SIDE)
    missing = disocclusion_mask(view.alpha, view.depth, small_config().repair.rules.scaled(64, 64))
    # The square's shadow on the wall is f * step * (1 / NEAR - 1 / FAR) = 4.2 pixels wide and 24 high.
    assert 50 <= missing[20:44].sum() <= 150
