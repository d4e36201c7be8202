"""The compiled renderer against the reference renderer, and the reference's gradients against finite differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from orca.anchors import GaussianAnchors
from orca.camera import Camera
from orca.config import RenderConfig
from orca.conventions import Float64Array, pixel_grid
from orca.field.decoders import Decoders
from orca.render import Renderer, render, select
from orca.render.aggregation import layer_index
from orca.render.reference import gather_hits, ray_tensors, render_rays
from orca.scene import Scene
from orca.threads import map_on_cores
from tests.orca.anchor_scenes import one_anchor, random_anchors, random_camera, random_decoders

MODES = {
    "layered": RenderConfig(),
    "per hit, window 2": RenderConfig(decode="per_hit", window=2),
    "per hit, whole layer": RenderConfig(decode="per_hit", window=-1),
}


def _reference_image(
    anchors: GaussianAnchors, decoders: Decoders, camera: Camera, config: RenderConfig
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Colour without background, alpha and depth sums of every pixel, in float64."""
    hits = torch.from_numpy(select(anchors, camera, config).padded())
    pixels = torch.from_numpy(pixel_grid(camera.width, camera.height))
    with torch.inference_mode():
        out = render_rays(_double(anchors), _double_decoders(decoders), camera, pixels, hits, config)
    shape = (camera.height, camera.width)
    return out[0].numpy().reshape(*shape, 3), out[1].numpy().reshape(shape), out[2].numpy().reshape(shape)


def _double(anchors: GaussianAnchors) -> GaussianAnchors:
    names = ("means", "log_variances", "quaternions", "opacity_logits", "features")
    return replace(anchors, **{name: getattr(anchors, name).double() for name in names})


def _double_decoders(decoders: Decoders) -> Decoders:
    copy = Decoders(decoders.use_direction)
    copy.load_state_dict(decoders.state_dict())
    return copy.double()


def _scene(seed: int, use_direction: bool = True) -> tuple[GaussianAnchors, Decoders, Camera]:
    camera = random_camera(seed, 45, 31)
    anchors = random_anchors(seed, 250, camera, (0.02, 0.3), (0.8, 5.0))
    decoders = random_decoders(seed, use_direction)
    with torch.no_grad():
        decoders.density_out.weight[0] *= 10  # densities from 0.002 to 35
    return anchors, decoders, camera


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("use_direction", [False, True])
def test_fast_renderer_equals_the_reference(mode: str, use_direction: bool) -> None:
    config = replace(MODES[mode], background=0.25)
    anchors, decoders, camera = _scene(0, use_direction)
    fast = Renderer(anchors, decoders, config).render(camera)
    rgb, alpha, depth = _reference_image(anchors, decoders, camera, config)
    np.testing.assert_allclose(fast.rgb, rgb + (1 - alpha[..., None]) * 0.25, atol=1e-4)
    np.testing.assert_allclose(fast.alpha, alpha, atol=1e-4)
    np.testing.assert_allclose(fast.depth * fast.alpha, depth, atol=2e-4)
    assert alpha.max() > 0.9 > 0.1 > alpha.min()
    assert fast.rgb.dtype == fast.alpha.dtype == fast.depth.dtype == np.float32


def test_the_modes_differ_on_that_scene() -> None:
    """Otherwise the test above could not tell one from another; and its rays cross several layers."""
    anchors, decoders, camera = _scene(0)
    images = [Renderer(anchors, decoders, config).render(camera).rgb for config in MODES.values()]
    for i, j in ((0, 1), (0, 2), (1, 2)):
        assert np.abs(images[i] - images[j]).max() > 0.01
    hits = torch.from_numpy(select(anchors, camera, RenderConfig()).padded())
    origin, directions = ray_tensors(anchors, camera, torch.from_numpy(pixel_grid(camera.width, camera.height)))
    gathered = gather_hits(anchors, origin, directions, hits)
    assert int(layer_index(gathered, RenderConfig())[gathered.valid].max()) >= 3
    assert int(gathered.valid.sum(1).max()) > 8


def test_direction_matters_on_that_scene() -> None:
    anchors, decoders, camera = _scene(0)
    with_direction = Renderer(anchors, decoders, RenderConfig()).render(camera).rgb
    without = Renderer(anchors, random_decoders(0), RenderConfig()).render(camera).rgb
    assert np.abs(with_direction - without).max() > 0.01


@pytest.mark.parametrize("mode", MODES)
def test_the_path_of_other_devices_gives_the_same_image(mode: str) -> None:
    """Any device but "cpu" takes torch operations; "cpu:0" is one that is always there."""
    anchors, decoders, camera = _scene(1)
    fast = Renderer(anchors, decoders, MODES[mode]).render(camera)
    other = Renderer(anchors, decoders, MODES[mode], device="cpu:0").render(camera)
    np.testing.assert_allclose(other.rgb, fast.rgb, atol=1e-3)  # float32 hits of thin anchors cost the reference digits
    np.testing.assert_allclose(other.alpha, fast.alpha, atol=1e-3)
    assert np.median(np.abs(other.rgb - fast.rgb)) < 1e-6


def test_a_renderer_elsewhere_leaves_the_given_decoders_alone() -> None:
    anchors, decoders, _ = _scene(1)
    assert Renderer(anchors, decoders, RenderConfig(), device="cpu:0").decoders is not decoders


@pytest.mark.parametrize("mode", MODES)
def test_workers_render_what_the_whole_machine_renders(mode: str) -> None:
    """All cores on one picture of many decoder chunks, twice; and one core a picture (the kernels' serial build)."""
    anchors, decoders, camera = _scene(2)
    renderer = Renderer(anchors, decoders, MODES[mode])
    assert renderer.hits(camera).count.sum() > 3 * 2048
    first, second = renderer.render(camera), renderer.render(camera)
    np.testing.assert_array_equal(first.rgb, second.rgb)
    for rendering in map_on_cores(lambda view: renderer.render(view), [camera, camera]):
        for name in ("rgb", "alpha", "depth"):
            np.testing.assert_allclose(getattr(rendering, name), getattr(first, name), rtol=2e-6, atol=1e-6)


def test_depth_of_one_opaque_anchor_is_where_it_is() -> None:
    camera = Camera.from_fov(9, 9, 40)
    anchors = replace(one_anchor([0, 0, 3], 0.2), opacity_logits=torch.tensor([8.0]))
    rendering = Renderer(anchors, random_decoders(0), RenderConfig()).render(camera)
    assert rendering.depth[4, 4] == pytest.approx(3.0, rel=1e-5)
    assert rendering.depth[0, 0] == 0
    assert rendering.alpha[0, 0] == 0


@pytest.mark.parametrize("mode", MODES)
def test_nothing_to_see_is_background(mode: str) -> None:
    camera = Camera.from_fov(7, 5, 40)
    config = replace(MODES[mode], background=0.5)
    rendering = Renderer(one_anchor([0, 0, -3], 0.2), random_decoders(0, True), config).render(camera)
    np.testing.assert_array_equal(rendering.rgb, np.full((5, 7, 3), 0.5, np.float32))
    assert not rendering.alpha.any()
    assert not rendering.depth.any()


def test_an_extended_renderer_equals_a_new_one() -> None:
    anchors, decoders, camera = _scene(3)
    old, new = anchors.subset(torch.arange(200)), anchors.subset(torch.arange(200, 250))
    before = Renderer(old, decoders, RenderConfig())
    image = before.render(camera)
    extended = before.extended(Renderer(new, decoders, RenderConfig())).render(camera)
    whole = Renderer(anchors, decoders, RenderConfig()).render(camera)
    np.testing.assert_allclose(extended.rgb, whole.rgb, rtol=2e-6, atol=1e-6)
    np.testing.assert_allclose(extended.depth, whole.depth, rtol=2e-6, atol=1e-6)
    np.testing.assert_array_equal(before.render(camera).rgb, image.rgb)  # the first is as it was
    assert np.abs(image.rgb - whole.rgb).max() > 0.01


def test_part_of_a_renderer_equals_a_new_one() -> None:
    anchors, decoders, camera = _scene(3)
    keep = np.random.default_rng(0).random(250) < 0.4
    part = Renderer(anchors, decoders, RenderConfig()).part(keep).render(camera)
    alone = Renderer(anchors.subset(torch.from_numpy(keep)), decoders, RenderConfig()).render(camera)
    np.testing.assert_allclose(part.rgb, alone.rgb, rtol=2e-6, atol=1e-6)
    np.testing.assert_allclose(part.depth, alone.depth, rtol=2e-6, atol=1e-6)
    elsewhere = Renderer(anchors, decoders, RenderConfig(), device="cpu:0").part(keep).render(camera)
    np.testing.assert_allclose(elsewhere.alpha, alone.alpha, atol=1e-3)


def test_overflow_is_reported() -> None:
    anchors, decoders, camera = _scene(4)
    renderer = Renderer(anchors, decoders, RenderConfig(max_hits=2))
    hits = renderer.hits(camera)
    assert renderer.render(camera).overflow == hits.overflow > 0
    assert Renderer(anchors, decoders, RenderConfig(max_hits=500)).render(camera).overflow == 0


def test_render_is_the_scenes_renderer() -> None:
    anchors, decoders, camera = _scene(5)
    scene = Scene(anchors, decoders, RenderConfig(background=1.0), camera)
    expected = Renderer(anchors, decoders, RenderConfig(background=1.0)).render(camera)
    np.testing.assert_array_equal(render(scene, camera).rgb, expected.rgb)


GRADIENTS_OF = ("opacity_logits", "log_variances", "quaternions", "means", "features")


def _two_layers(camera: Camera) -> GaussianAnchors:
    """Four overlapping anchors, three of them one surface, in float64."""
    anchors = random_anchors(6, 4, camera, (0.15, 0.4), dtype=torch.float64)
    pixels = np.array([[4.6, 5.1], [5.8, 5.0], [5.0, 5.9], [5.1, 5.2]])
    return replace(anchors, means=torch.from_numpy(camera.unproject(pixels, np.array([2.0, 2.05, 2.1, 4.0]))))


@pytest.mark.parametrize("mode", MODES)
def test_gradients_equal_finite_differences(mode: str) -> None:
    """All parameters of all anchors, through colour, alpha and depth; features along random directions, being many."""
    camera, config = random_camera(6, 12, 10), MODES[mode]
    anchors, decoders = _two_layers(camera), _double_decoders(random_decoders(6, use_direction=True))
    pixels = torch.tensor([[4.5, 5.5], [6.0, 4.0], [5.2, 6.1], [5.5, 4.5]], dtype=torch.float64)
    hits = torch.tensor([[0, 1, 2, 3], [0, 2, 3, -1], [1, -1, -1, -1], [-1, -1, -1, -1]])
    hits = hits.gather(1, gather_hits(anchors, *ray_tensors(anchors, camera, pixels), hits).t.argsort(1))

    def outputs(*parameters: torch.Tensor) -> tuple[torch.Tensor, ...]:
        current = replace(anchors, **dict(zip(GRADIENTS_OF, parameters)))
        return render_rays(current, decoders, camera, pixels, hits, config)

    tracked = [getattr(anchors, name).clone().requires_grad_() for name in GRADIENTS_OF]
    geometry, features = tracked[:-1], tracked[-1]
    tolerance = {"eps": 1e-6, "atol": 1e-6, "rtol": 1e-4}
    assert torch.autograd.gradcheck(lambda *p: outputs(*p, features.detach()), geometry, **tolerance)
    fixed = [x.detach() for x in geometry]
    assert torch.autograd.gradcheck(lambda f: outputs(*fixed, f), [features], fast_mode=True, **tolerance)
    gradients = torch.autograd.grad(sum(x.sum() for x in outputs(*tracked)), tracked)
    assert all(g.abs().max() > 1e-4 for g in gradients)


def test_gradients_of_the_decoders_equal_finite_differences() -> None:
    camera = random_camera(6, 12, 10)
    anchors = random_anchors(6, 5, camera, (0.3, 0.5), (2.0, 3.0), dtype=torch.float64)
    decoders = _double_decoders(random_decoders(6, use_direction=True))
    pixels = torch.tensor([[5.5, 5.5], [4.5, 5.5]], dtype=torch.float64)
    hits = torch.tensor([[1, 2, 3], [2, 4, -1]])
    names = [name for name, _ in decoders.named_parameters()]

    def outputs(*weights: torch.Tensor) -> torch.Tensor:
        features, directions = anchors.features, torch.nn.functional.normalize(ray_tensors(anchors, camera, pixels)[1])
        sigma, colour = torch.func.functional_call(
            decoders, dict(zip(names, weights)), (features[hits[:, 0]], directions)
        )
        return torch.cat([sigma[:, None], colour], 1)

    weights = [p.detach().clone().requires_grad_() for p in decoders.parameters()]
    assert torch.autograd.gradcheck(outputs, weights, eps=1e-6, atol=1e-6, rtol=1e-4, fast_mode=True)
