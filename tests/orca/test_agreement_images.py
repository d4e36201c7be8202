"""Images of the fast renderer within 1e-4 of the float64 reference: real scenes, edge cases, thread counts."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numba
import numpy as np
import pytest
import torch

from orca.anchors import GaussianAnchors
from orca.camera import Camera
from orca.config import RenderConfig
from orca.field.decoders import Decoders
from orca.render import Renderer, Rendering, select_brute_force
from tests.orca.agreement import MODES, fitted_scene, moved, reference_pixels
from tests.orca.anchor_scenes import one_anchor, random_anchors, random_camera, random_decoders

TOLERANCE = 1e-4
TWO_MODES = ("layered", "per hit")


@dataclass(frozen=True)
class Case:
    """Something to look at, and from where."""

    anchors: GaussianAnchors
    camera: Camera
    max_hits: int = 64


def _dense(decoders: Decoders) -> Decoders:
    """Random decoders whose densities reach from see-through to opaque."""
    with torch.no_grad():
        decoders.density_out.weight[0] *= 10
    return decoders


def _assert_agrees(case: Case, decoders: Decoders, config: RenderConfig) -> Rendering:
    """Hold the renderer to the reference on hits found by brute force; the image."""
    config = replace(config, max_hits=case.max_hits, background=0.25)
    fast = Renderer(case.anchors, decoders, config).render(case.camera)
    hits = select_brute_force(case.anchors, case.camera, config)
    rgb, alpha, depth = reference_pixels(case.anchors, decoders, case.camera, config, hits)
    assert fast.rgb.shape == (case.camera.height, case.camera.width, 3)
    np.testing.assert_allclose(fast.rgb.reshape(-1, 3), rgb, atol=TOLERANCE, rtol=0)
    np.testing.assert_allclose(fast.alpha.ravel(), alpha, atol=TOLERANCE, rtol=0)
    np.testing.assert_allclose((fast.depth * fast.alpha).ravel(), depth, atol=TOLERANCE * max(1, depth.max()), rtol=0)
    assert fast.overflow == hits.overflow
    return fast


def _no_hit() -> Case:
    return Case(one_anchor([50, 0, 1], 0.01), Camera.from_fov(9, 5, 50))


def _camera_inside() -> Case:
    """A large ellipsoid around the camera, left out, and a small one in front, seen."""
    both = GaussianAnchors.concatenate(one_anchor([0, 0, 1], 0.5), one_anchor([0, 0, 2], 0.2))
    return Case(both, Camera.from_fov(16, 12, 60))


def _behind() -> Case:
    camera = random_camera(31, 24, 20)
    anchors = random_anchors(31, 80, camera, (0.05, 0.2), (0.8, 3.0))
    centre = torch.from_numpy(camera.center).float()
    mirrored = replace(anchors, means=2 * centre - anchors.means)
    return Case(GaussianAnchors.concatenate(mirrored, anchors), camera)


def _across_the_camera_plane() -> Case:
    return Case(one_anchor([0.0, 0.5, 1.0], [0.1, 0.1, 0.6]), Camera.from_fov(40, 30, 60))


def _overflow() -> Case:
    camera = random_camera(32, 30, 20)
    return Case(random_anchors(32, 150, camera, (0.1, 0.6), (0.8, 5.0)), camera, max_hits=4)


def _degenerate() -> Case:
    """Points, sheets, needles and balls larger than the scene, between ordinary anchors.

    Axes along the world's: of a sheet 10^4 times as wide as thick, freely turned, float32 does not hold the plane.
    """
    camera = random_camera(33, 26, 22)
    anchors = random_anchors(33, 60, camera, (0.05, 0.3), (0.8, 4.0))
    log_variances, upright = anchors.log_variances.clone(), torch.zeros_like(anchors.quaternions)
    log_variances[1::6] = -60.0
    log_variances[2::6, 0] = -20.0
    log_variances[3::6, :2] = -20.0
    log_variances[4::6] = 20.0
    upright[:, 0] = 1.0
    return Case(replace(anchors, log_variances=log_variances, quaternions=upright), camera)


def _one_pixel() -> Case:
    camera = Camera.from_fov(1, 1, 60)
    anchors = random_anchors(34, 60, Camera.from_fov(1, 1, 20), (0.1, 0.4), (1.0, 4.0))
    return Case(anchors, camera)


def _wide() -> Case:
    camera = random_camera(35, 97, 13)
    return Case(random_anchors(35, 200, camera, (0.02, 0.3), (0.8, 5.0)), camera)


def _tall() -> Case:
    camera = random_camera(36, 7, 83)
    return Case(random_anchors(36, 200, camera, (0.02, 0.3), (0.8, 5.0)), camera)


CASES: dict[str, Callable[[], Case]] = {
    "no hit at all": _no_hit,
    "camera inside an ellipsoid": _camera_inside,
    "anchors behind the camera": _behind,
    "across the camera plane": _across_the_camera_plane,
    "hit overflow": _overflow,
    "degenerate covariances": _degenerate,
    "1x1": _one_pixel,
    "97x13": _wide,
    "7x83": _tall,
}


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("name", CASES)
def test_edge_cases_agree(name: str, mode: str) -> None:
    case = CASES[name]()
    seen = _assert_agrees(case, _dense(random_decoders(3)), MODES[mode])
    assert (seen.overflow > 100) == (name == "hit overflow")
    assert (seen.alpha.max() > 0.1) == (name != "no hit at all")


@pytest.mark.parametrize("mode", TWO_MODES)
def test_a_real_scene_agrees_from_another_place(mode: str) -> None:
    """Every pixel of a photograph after stage 2, seen by a moved camera; a fresh camera, so no hit is reused."""
    scene = fitted_scene(96, mode)
    camera = moved(scene.camera)
    renderer = scene.renderer()
    hits = renderer.hits(camera)
    fast = renderer.render(camera)
    rgb, alpha, _ = reference_pixels(scene.anchors, scene.decoders, camera, scene.render_config, hits)
    np.testing.assert_allclose(fast.rgb.reshape(-1, 3), rgb, atol=TOLERANCE, rtol=0)
    np.testing.assert_allclose(fast.alpha.ravel(), alpha, atol=TOLERANCE, rtol=0)
    assert 4 < hits.count.mean() < 9
    assert fast.rgb.std() > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("mode", TWO_MODES)
def test_1020_pixels_square_agree_on_sampled_rays(mode: str) -> None:
    """The largest images of the data sets; no power of two, and no multiple of a tile."""
    scene = fitted_scene(96, mode)
    camera = moved(scene.camera).resized(1020, 1020)
    renderer = scene.renderer()
    hits = renderer.hits(camera)
    fast = renderer.render(camera)
    corners = np.array([0, 1019, 1020 * 1019, 1020 * 1020 - 1])
    rays = np.unique(np.concatenate([corners, np.random.default_rng(0).integers(0, 1020**2, 1000)]))
    rgb, alpha, _ = reference_pixels(scene.anchors, scene.decoders, camera, scene.render_config, hits, rays)
    np.testing.assert_allclose(fast.rgb.reshape(-1, 3)[rays], rgb, atol=TOLERANCE, rtol=0)
    np.testing.assert_allclose(fast.alpha.ravel()[rays], alpha, atol=TOLERANCE, rtol=0)
    assert fast.rgb.shape == (1020, 1020, 3)


@pytest.fixture
def two_cores() -> Iterator[None]:
    """Puts numba's thread count back; skips where there is one core only."""
    before = numba.get_num_threads()
    if numba.config.NUMBA_NUM_THREADS < 2:
        pytest.skip("one core")
    yield
    numba.set_num_threads(before)


@pytest.mark.usefixtures("two_cores")
@pytest.mark.parametrize("mode", TWO_MODES)
def test_one_thread_and_two_give_the_same_image(mode: str) -> None:
    scene = fitted_scene(96, mode)
    images = []
    for threads in (1, 2):
        numba.set_num_threads(threads)
        images.append(scene.renderer().render(moved(scene.camera)))
    for name in ("rgb", "alpha", "depth"):
        np.testing.assert_allclose(getattr(images[0], name), getattr(images[1], name), rtol=2e-6, atol=1e-6)
