"""Front-to-back quadrature: a hand-worked ray, conservation, and the compiled version."""

from __future__ import annotations

import math

import numpy as np
import torch

from orca.render.quadrature import composite
from orca.stages.linear import _shares


def _random(rays: int, samples: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    sigma = 5 * torch.rand(rays, samples, generator=generator)
    opacity = torch.rand(rays, samples, generator=generator)
    colour = torch.rand(rays, samples, 3, generator=generator)
    t = torch.rand(rays, samples, generator=generator).sort(1).values + 0.5
    return sigma, opacity, colour, t


def test_two_samples_by_hand() -> None:
    """sigma a = ln 2 halves the light, ln 4 quarters it: weights 1/2 and 1/2 * 3/4 = 3/8, 1/8 gets through."""
    sigma = torch.tensor([[2 * math.log(2), math.log(4)]])
    opacity = torch.tensor([[0.5, 1.0]])
    colour = torch.tensor([[[1.0, 0.0, 0.5], [0.0, 1.0, 0.5]]])
    rgb, alpha, depth = composite(sigma, opacity, colour, torch.tensor([[2.0, 4.0]]))
    torch.testing.assert_close(rgb, torch.tensor([[0.5, 0.375, 0.4375]]))
    torch.testing.assert_close(alpha, torch.tensor([0.875]))
    torch.testing.assert_close(depth, torch.tensor([0.5 * 2 + 0.375 * 4]))


def test_what_is_not_absorbed_gets_through() -> None:
    """Sum of the weights = 1 - prod(1 - alpha_k)."""
    sigma, opacity, colour, t = _random(100, 7)
    alpha = composite(sigma, opacity, colour, t)[1]
    torch.testing.assert_close(alpha, 1 - torch.exp(-sigma * opacity).prod(1))


def test_one_colour_stays_that_colour() -> None:
    sigma, opacity, colour, t = _random(50, 6)
    rgb, alpha, _ = composite(sigma, opacity, torch.full_like(colour, 0.3), t)
    torch.testing.assert_close(rgb, 0.3 * alpha[:, None].expand(-1, 3))


def test_an_opaque_front_hides_the_rest() -> None:
    sigma, opacity, colour, t = _random(10, 4)
    sigma[:, 0], opacity[:, 0] = 1e4, 1.0
    rgb, alpha, depth = composite(sigma, opacity, colour, t)
    torch.testing.assert_close(rgb, colour[:, 0])
    torch.testing.assert_close(alpha, torch.ones(10))
    torch.testing.assert_close(depth, t[:, 0])


def test_empty_samples_change_nothing() -> None:
    sigma, opacity, colour, t = _random(10, 4)
    padded = [torch.cat([x, torch.rand_like(x[:, :2])], 1) for x in (sigma, opacity, colour, t)]
    padded[0][:, 4:] = 0
    for a, b in zip(composite(sigma, opacity, colour, t), composite(*padded)):
        torch.testing.assert_close(a, b)


def test_compiled_quadrature_equals_the_reference() -> None:
    """Rays of 0 to 6 samples in one table, against the padded form."""
    sigma, opacity, colour, t = _random(40, 6)
    count = np.arange(40) % 7
    sigma[torch.arange(6)[None] >= torch.from_numpy(count)[:, None]] = 0
    start = np.concatenate([[0], np.cumsum(count)])
    keep = torch.arange(6)[None] < torch.from_numpy(count)[:, None]
    flat = [x[keep].numpy() for x in (sigma, opacity, colour, t)]
    _, alpha, _ = composite(sigma, opacity, colour, t)
    weights = _shares(start, flat[0], flat[1])
    ray = np.repeat(np.arange(40), count)
    np.testing.assert_allclose(np.bincount(ray, weights, 40), alpha.numpy(), atol=1e-6)
