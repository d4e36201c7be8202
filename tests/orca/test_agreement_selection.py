"""Selection against every ray tried on every anchor in 3D: no difference in float64, next to none in float32."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import torch
from numpy.typing import NDArray

from orca.anchors import GaussianAnchors
from orca.camera import Camera
from orca.config import RenderConfig
from orca.render import HitList, select, select_brute_force
from orca.render.selector import ray_anchor_closest_approach
from tests.orca.anchor_scenes import random_anchors, random_camera

CONFIG = RenderConfig(max_hits=100_000)
# seed, anchors, width, height, sigma (per axis: anisotropic), depth; every camera is rotated and has skew
SCENES = (
    (20, 250, 61, 43, (0.01, 0.25), (0.3, 6.0)),
    (21, 200, 53, 71, (0.005, 0.6), (0.5, 5.0)),
    (22, 900, 64, 40, (0.01, 0.05), (0.5, 4.0)),
    (23, 120, 47, 33, (0.1, 0.8), (0.5, 6.0)),
)


@cache
def _scenes() -> list[tuple[GaussianAnchors, Camera, HitList]]:
    """Anchors, camera, and the hits that trying every ray on every anchor finds."""
    scenes = []
    for seed, count, width, height, sigma, depth in SCENES:
        camera = random_camera(seed, width, height)
        anchors = random_anchors(seed, count, camera, sigma, depth)
        scenes.append((anchors, camera, select_brute_force(anchors, camera, CONFIG)))
    return scenes


def _pairs(hits: HitList) -> NDArray[np.int64]:
    """Every (ray, anchor) as one number, in the order of the list."""
    return np.concatenate(
        [
            (ray << 32) + hits.anchor[hits.start[ray] : hits.start[ray] + hits.count[ray]].astype(np.int64)
            for ray in range(hits.num_rays)
        ]
    )


def test_no_hit_differs_from_the_3d_test_in_float64() -> None:
    """The same hits, each ray's in the same order."""
    total = 0
    for anchors, camera, exact in _scenes():
        fast, slow = _pairs(select(anchors, camera, CONFIG)), _pairs(exact)
        np.testing.assert_array_equal(np.sort(fast), np.sort(slow))
        swapped = int((fast != slow).sum())  # two hits at one depth, to float32, may stand either way round
        assert swapped <= 2
        total += len(slow)
    assert total >= 50_000


def test_capped_hits_are_the_same_too() -> None:
    """The cap cuts the far end of the sorted list: the same hits stay, and the same number is reported."""
    config = replace(CONFIG, max_hits=4)
    anchors, camera, _ = _scenes()[-1]
    fast, slow = select(anchors, camera, config), select_brute_force(anchors, camera, config)
    assert fast.overflow == slow.overflow > 1000
    assert len(np.setxor1d(_pairs(fast), _pairs(slow))) <= 2  # a tie at the cut


def test_at_most_one_hit_in_5000_differs_in_float32() -> None:
    """The formulas of the reference, run in float32 as on a GPU."""
    differing, total = 0, 0
    for anchors, camera, exact in _scenes():
        t, m2, _ = ray_anchor_closest_approach(
            torch.from_numpy(camera.center).float(),
            torch.from_numpy(camera.rays()).float()[:, None],
            anchors.means[None],
            anchors.whitening()[None],
        )
        rays, who = ((m2 <= CONFIG.chi2) & (t > CONFIG.near)).numpy().nonzero()
        usable = np.unique(exact.anchor)  # neither behind the camera nor around it
        keep = np.isin(who, usable)
        single = (rays[keep].astype(np.int64) << 32) + who[keep]
        differing += len(np.setxor1d(single, _pairs(exact)))
        total += len(_pairs(exact))
    assert differing <= total / 5000
    assert total >= 50_000
