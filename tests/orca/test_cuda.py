"""What runs on a GPU, held to the CPU: selection, images, gradients, training, whole scenes. Skipped without one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch

from orca.camera import Camera
from orca.config import get_preset
from orca.pipeline import reconstruct
from orca.priors.depth import DepthEstimate
from orca.render.expand import expand_hits
from orca.render.renderer import Renderer
from orca.render.selector import select
from tests.orca.agreement import MODES, fitted_scene, moved, photo, stepped_depth
from tests.orca.test_agreement_gradients import (
    Gradients,
    Problem,
    exact_gradients,
    flat_gradients,
    problem,
    torch_gradients,
)

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU that torch can use")

SIZE = 160


@pytest.mark.parametrize("most", [1000, 3])
def test_hits_are_those_of_the_cpu(most: int) -> None:
    """Up to one in 5,000 may differ: float64 sums of the GPU round in another order."""
    scene = fitted_scene(SIZE, "layered")
    camera, config = moved(scene.camera), replace(scene.render_config, max_hits=most)
    hits, overflow = expand_hits(scene.anchors.to("cuda"), camera, config)
    expected = select(scene.anchors, camera, config)
    ray, anchor = expected.flat(np.arange(SIZE * SIZE))
    found = set(zip(hits.ray.tolist(), hits.anchor.tolist(), strict=True))
    wanted = set(zip(ray.tolist(), anchor.tolist(), strict=True))
    assert len(wanted) > 50_000
    assert len(found ^ wanted) <= len(wanted) / 5000
    assert abs(overflow - expected.overflow) <= len(wanted) / 5000


@pytest.mark.parametrize("mode", MODES)
def test_images_are_those_of_the_cpu(mode: str) -> None:
    scene = fitted_scene(SIZE, mode)
    camera = moved(scene.camera)
    given = Renderer(scene.anchors, scene.decoders, MODES[mode], "cuda").render(camera)
    expected = Renderer(scene.anchors, scene.decoders, MODES[mode]).render(camera)
    difference = np.abs(given.rgb - expected.rgb).max(2)
    assert np.quantile(difference, 0.999) <= 1e-4  # a hit at the very border of an ellipsoid may be one device's only
    assert difference.mean() <= 1e-5
    np.testing.assert_allclose(given.alpha.mean(), expected.alpha.mean(), atol=1e-5)
    assert next(scene.decoders.parameters()).device.type == "cpu"  # the scene's own stay where they were


GIVEN: dict[str, Callable[[Problem], Gradients]] = {
    "reference": lambda of: torch_gradients(of, torch.float32, "cuda"),
    "flat": lambda of: flat_gradients(of, "cuda"),
}


@pytest.mark.parametrize("mode", ["layered", "per hit"])
@pytest.mark.parametrize("path", GIVEN)
def test_gradients_of_every_parameter(path: str, mode: str) -> None:
    of = problem(mode)
    given = GIVEN[path](of)
    for name, exact in exact_gradients(mode).items():
        a, b = given[name].double().cpu().ravel(), exact.ravel()
        assert (a - b).norm() <= 2e-3 * b.norm(), name
        assert torch.dot(a, b) >= 0.9999 * a.norm() * b.norm(), name


@pytest.mark.parametrize("preset", ["draft", "quality", "paper"])
def test_a_whole_scene_is_as_good_as_the_cpu_s(preset: str) -> None:
    """The paper's preset is trained by 200 steps a stage: random numbers differ, so only the quality is compared."""
    config = get_preset(preset)
    planar = replace(config.planar, max_iterations=min(200, config.planar.max_iterations))
    deform = replace(config.deform, max_iterations=min(200, config.deform.max_iterations))
    config = replace(config, planar=planar, deform=deform)
    camera = Camera.from_fov(96, 96, 60)
    depth = DepthEstimate(stepped_depth(96), "made up", False)
    psnr = [
        reconstruct(photo(96), camera, depth, (camera, moved(camera)), config, device=device).record["input_psnr"]
        for device in ("cpu", "cuda")
    ]
    assert psnr[0].keys() == psnr[1].keys()
    assert all(abs(psnr[0][stage] - psnr[1][stage]) < 0.3 for stage in psnr[0])
