"""The splat renderer against the formulas written out, and the gradient against finite differences."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from orca.camera import Camera
from orca.conventions import Float32Array, Float64Array, pixel_grid
from orca.errors import BadInput
from orca.splats.gradient import footprints, loss_and_gradient
from orca.splats.model import Splats
from orca.splats.raster import rasterise
from orca.splats.view import render_splats, view_splats

CAMERA = Camera.from_fov(24, 18, 60.0)


def some_splats(n: int, seed: int) -> Splats:
    rng = np.random.default_rng(seed)
    quaternions = rng.normal(size=(n, 4))
    return Splats(
        means=np.stack([rng.uniform(-1, 1, n), rng.uniform(-0.8, 0.8, n), rng.uniform(1.2, 3, n)], 1).astype(
            np.float32
        ),
        log_scales=np.log(rng.uniform(0.03, 0.3, (n, 3))).astype(np.float32),
        quaternions=(quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).astype(np.float32),
        colours=rng.random((n, 3), np.float32),
        opacities=rng.uniform(0.1, 0.9, n).astype(np.float32),
        stage=(np.arange(n) % 3).astype(np.uint8),
    )


def slow_footprint(splats: Splats, i: int, camera: Camera) -> tuple[Float64Array, Float64Array]:
    """Pixel position and projected covariance of one splat, before dilation, in double precision."""
    px, py, z = splats.means[i].astype(float) @ camera.rotation.T + camera.translation
    fx, fy = camera.K[0, 0], camera.K[1, 1]
    limit_x, limit_y = 1.3 * camera.width / (2 * fx), 1.3 * camera.height / (2 * fy)
    tx, ty = np.clip(px / z, -limit_x, limit_x), np.clip(py / z, -limit_y, limit_y)
    jacobian = np.array([[fx / z, 0, -fx * tx / z], [0, fy / z, -fy * ty / z]])
    cov = jacobian @ camera.rotation @ splats.covariances()[i].astype(float) @ camera.rotation.T @ jacobian.T
    return np.array([fx * px / z + camera.K[0, 2], fy * py / z + camera.K[1, 2]]), cov


def slow_render(splats: Splats, camera: Camera) -> Float32Array:
    """Splat by splat over whole images, as Kerbl et al. 2023 have it; no compiled code, no lists of hits."""
    pixels = pixel_grid(camera.width, camera.height)
    out, through = np.zeros((len(pixels), 3)), np.ones(len(pixels))
    depth = splats.means.astype(float) @ camera.rotation[2] + camera.translation[2]
    for i in np.argsort(depth, kind="stable"):
        centre, cov = slow_footprint(splats, i, camera)
        offset = pixels - centre
        m2 = (offset @ np.linalg.inv(cov + 0.3 * np.eye(2)) * offset).sum(1)
        alpha = np.minimum(0.99, float(splats.opacities[i]) * np.exp(-0.5 * m2))
        alpha[alpha < 1 / 255] = 0
        out += (through * alpha)[:, None] * splats.colours[i]
        through *= 1 - alpha
    return out.reshape(camera.height, camera.width, 3).astype(np.float32)


@pytest.mark.parametrize("seed", [0, 1])
def test_agrees_with_the_formulas(seed: int) -> None:
    splats = some_splats(12, seed)
    np.testing.assert_allclose(render_splats(splats, CAMERA), slow_render(splats, CAMERA), atol=2e-5)


def test_agrees_with_the_formulas_from_another_place() -> None:
    angle = 0.3
    pose = np.eye(4)
    pose[:3, :3] = [[math.cos(angle), 0, math.sin(angle)], [0, 1, 0], [-math.sin(angle), 0, math.cos(angle)]]
    pose[:3, 3] = [0.1, -0.05, 0.2]
    camera = replace(CAMERA, world_to_camera=pose)
    splats = some_splats(12, 3)
    np.testing.assert_allclose(render_splats(splats, camera), slow_render(splats, camera), atol=2e-5)


def test_one_splat_by_hand() -> None:
    """A ball of sigma 0.2 two units ahead, focal length 20: sigma 2 px, variance 4 + 0.3 at its centre."""
    camera = Camera(np.array([[20.0, 0, 10.5], [0, 20.0, 10.5], [0, 0, 1]]), np.eye(4), 21, 21)
    one = Splats(
        means=np.array([[0, 0, 2]], np.float32),
        log_scales=np.log(np.full((1, 3), 0.2, np.float32)),
        quaternions=np.array([[1, 0, 0, 0]], np.float32),
        colours=np.array([[1.0, 0.5, 0.0]], np.float32),
        opacities=np.array([0.8], np.float32),
        stage=np.zeros(1, np.uint8),
    )
    picture = render_splats(one, camera)
    assert picture[10, 10].tolist() == pytest.approx([0.8, 0.4, 0.0], abs=1e-6)
    assert picture[10, 13, 0] == pytest.approx(0.8 * math.exp(-9 / (2 * 4.3)), abs=1e-6)
    assert render_splats(one, camera, background=1.0)[10, 10].tolist() == pytest.approx([1.0, 0.6, 0.2], abs=1e-6)


def test_the_nearer_splat_hides_the_farther() -> None:
    splats = some_splats(2, 5)
    splats = replace(
        splats, means=np.array([[0, 0, 3], [0, 0, 1.5]], np.float32), opacities=np.full(2, 0.9, np.float32)
    )
    hits = rasterise(splats, CAMERA)
    centre = 9 * CAMERA.width + 12
    assert hits.splat[hits.start[centre] : hits.start[centre + 1]].tolist() == [1, 0]
    behind = replace(splats, means=-splats.means)
    assert len(rasterise(behind, CAMERA).splat) == 0


def autograd_loss(
    splats: Splats, target: Float32Array, colours: torch.Tensor, opacities: torch.Tensor, growth: torch.Tensor
) -> torch.Tensor:
    """The same loss by torch in double precision; what is below 1/255 now is left out, and stays out."""
    pixels = torch.from_numpy(pixel_grid(CAMERA.width, CAMERA.height))
    out, through = torch.zeros(len(pixels), 4, dtype=torch.float64), torch.ones(len(pixels), dtype=torch.float64)
    for i in np.argsort(splats.means[:, 2], kind="stable"):
        centre, cov = slow_footprint(splats, i, CAMERA)
        grown = torch.from_numpy(cov) * torch.exp(2 * growth[i]) + 0.3 * torch.eye(2, dtype=torch.float64)
        offset = pixels - torch.from_numpy(centre)
        alpha = opacities[i] * torch.exp(-0.5 * (offset @ torch.linalg.inv(grown) * offset).sum(1))
        alpha = torch.where(alpha < 1 / 255, 0.0, alpha.clamp_max(0.99))
        out = out + (through * alpha)[:, None] * torch.cat([colours[i], torch.ones(1, dtype=torch.float64)])
        through = through * (1 - alpha)
    difference: torch.Tensor = out - torch.from_numpy(target)
    return (difference**2).sum()


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 1000))
def test_gradient_is_that_of_autograd(seed: int) -> None:
    rng = np.random.default_rng(seed)
    splats = some_splats(8, seed)
    target = rng.random((CAMERA.width * CAMERA.height, 4), np.float32)
    growth = rng.uniform(-0.2, 0.2, 8).astype(np.float32)
    loss, gradient = loss_and_gradient(
        footprints(splats, CAMERA, 1.5), target, splats.colours, splats.opacities, growth
    )
    parts = [
        torch.tensor(v, dtype=torch.float64, requires_grad=True) for v in (splats.colours, splats.opacities, growth)
    ]
    expected = autograd_loss(splats, target, *parts)
    expected.backward()
    assert loss == pytest.approx(float(expected.detach()), rel=2e-3)
    by = torch.cat([parts[0].grad, parts[1].grad[:, None], parts[2].grad[:, None]], 1).numpy()  # type: ignore[list-item]
    # A pixel at the very cut may fall on either side of it in single precision.
    np.testing.assert_allclose(2 * gradient, by, atol=0.02 * np.abs(by).max() + 1e-3)


def test_footprints_compose_to_the_same_loss_as_the_renderer() -> None:
    splats = some_splats(20, 8)
    picture = view_splats(splats, CAMERA).rgb.reshape(-1, 3)
    picture = np.concatenate([picture, view_splats(splats, CAMERA).alpha.reshape(-1, 1)], 1)
    loss, gradient = loss_and_gradient(
        footprints(splats, CAMERA, 1.0), picture, splats.colours, splats.opacities, np.zeros(20, np.float32)
    )
    assert loss < 1e-6
    assert np.abs(gradient).max() < 1e-3


def test_wrong_shapes_are_refused() -> None:
    with pytest.raises(BadInput, match="colours"):
        replace(some_splats(3, 0), colours=np.zeros((2, 3), np.float32))
