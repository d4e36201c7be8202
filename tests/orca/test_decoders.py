"""The decoders: the analytic pass-through, spherical harmonics, the clamped exponential."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.special import sph_harm_y

from orca.anchors import FEATURE_DIM
from orca.field.decoders import (
    COLOUR_CHANNELS,
    DENSITY_CHANNEL,
    Decoders,
    analytic_decoders,
    spherical_harmonics,
)
from tests.orca.anchor_scenes import random_decoders


def _generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def _features(count: int = 200) -> torch.Tensor:
    features = 3 * torch.randn(count, FEATURE_DIM, generator=_generator())
    features[:, DENSITY_CHANNEL] = 1.0
    return features


@pytest.mark.parametrize("density", [0.5, 1.0, 15.0, 300.0])
def test_analytic_decoders_pass_colour_and_density_through(density: float) -> None:
    features = _features()
    decoders = analytic_decoders(density, _generator())
    sigma, rgb = decoders(features)
    logits = decoders.density(decoders.density_in(features))[1][:, :COLOUR_CHANNELS]
    assert torch.equal(logits, features[:, :COLOUR_CHANNELS])  # bit for bit
    torch.testing.assert_close(rgb, torch.sigmoid(features[:, :COLOUR_CHANNELS]), rtol=0, atol=2e-7)
    torch.testing.assert_close(sigma, torch.full((200,), density), rtol=1e-5, atol=0)


def test_noise_opens_the_other_weights_to_gradients() -> None:
    features = _features()
    noisy = analytic_decoders(15.0, _generator(), noise=0.1)
    assert (noisy(features)[1] - torch.sigmoid(features[:, :3])).abs().max() > 1e-3
    exact = analytic_decoders(15.0, _generator())
    zero = {name: int((p == 0).sum()) for name, p in exact.named_parameters()}
    assert all(zero[name] > 0.9 * p.numel() for name, p in exact.named_parameters())
    assert all((p != 0).all() for p in noisy.parameters())


def test_first_layer_may_be_applied_before_the_aggregation() -> None:
    decoders, features = random_decoders(1), _features(3)
    weights = torch.tensor([0.2, 0.5, 0.3])
    late = decoders.density_in(weights @ features)
    early = weights @ decoders.density_in(features)
    torch.testing.assert_close(late, early, rtol=1e-5, atol=1e-5)


def test_direction_matters_only_when_it_is_used() -> None:
    directions = torch.nn.functional.normalize(torch.randn(2, 200, 3, generator=_generator()), dim=-1)
    features = _features()
    off, on = random_decoders(2), random_decoders(2, use_direction=True)
    assert torch.equal(off(features, directions[0])[1], off(features, directions[1])[1])
    assert (on(features, directions[0])[1] - on(features, directions[1])[1]).abs().max() > 1e-2
    assert torch.equal(on(features, directions[0])[0], on(features, directions[1])[0])  # density is not view-dependent


def test_initial_weights_come_from_the_generator_and_stay_in_bounds() -> None:
    one, same, other = (Decoders(generator=_generator(s)) for s in (5, 5, 6))
    for a, b, c in zip(one.parameters(), same.parameters(), other.parameters()):
        assert torch.equal(a, b)
        assert not torch.equal(a, c)
        assert a.abs().max() <= 1 / math.sqrt(a.shape[1])
        assert a.abs().max() > 0.9 / math.sqrt(a.shape[1])


def test_layer_sizes() -> None:
    shapes = {name.split(".")[0]: tuple(p.shape) for name, p in Decoders().named_parameters()}
    assert shapes == {
        "density_in": (64, 32),
        "density_out": (16, 64),
        "colour_in": (64, 31),
        "colour_mid": (64, 64),
        "colour_out": (3, 64),
    }  # and no bias


def _sphere_quadrature() -> tuple[torch.Tensor, torch.Tensor]:
    """Directions and weights that integrate polynomials up to degree 15 over the sphere exactly."""
    z, wz = np.polynomial.legendre.leggauss(8)
    phi = np.arange(16) * (2 * np.pi / 16)
    r = np.sqrt(1 - z**2)
    xyz = np.stack([np.outer(r, np.cos(phi)), np.outer(r, np.sin(phi)), np.outer(z, np.ones(16))], -1)
    return torch.from_numpy(xyz.reshape(-1, 3)), torch.from_numpy(np.repeat(wz, 16) * (2 * np.pi / 16))


def test_spherical_harmonics_are_orthonormal() -> None:
    directions, weights = _sphere_quadrature()
    basis = spherical_harmonics(directions)
    gram = basis.T @ (basis * weights[:, None])
    torch.testing.assert_close(gram, torch.eye(16, dtype=torch.float64), rtol=0, atol=1e-9)


def test_spherical_harmonics_are_scipys_in_real_form() -> None:
    """m < 0: sqrt(2) Im Y_l^|m|; m > 0: sqrt(2) Re Y_l^m; with the Condon-Shortley phase."""
    directions, _ = _sphere_quadrature()
    x, y, z = directions.numpy().T
    theta, phi = np.arccos(z), np.arctan2(y, x)
    expected = []
    for degree in range(4):
        for m in range(-degree, degree + 1):
            value = sph_harm_y(degree, abs(m), theta, phi)
            expected.append(value.real if m == 0 else math.sqrt(2) * (value.imag if m < 0 else value.real))
    np.testing.assert_allclose(spherical_harmonics(directions).numpy(), np.stack(expected, -1), atol=1e-9)


@pytest.mark.parametrize(
    ("logit", "density", "gradient"),
    [
        (0.0, math.exp(0.0), math.exp(0.0)),
        (3.0, math.exp(3.0), math.exp(3.0)),
        (40.0, math.exp(15.0), math.exp(15.0)),
        (-40.0, math.exp(-40.0), math.exp(-15.0)),
    ],
)
def test_truncated_exponential(logit: float, density: float, gradient: float) -> None:
    """sigma = exp(h - 1), read through a first layer of one unit whose weight carries the sign."""
    decoders = Decoders()
    with torch.no_grad():
        decoders.density_out.weight.zero_()
        decoders.density_out.weight[0, 0] = math.copysign(1.0, logit + 1)
    hidden = torch.zeros(1, 64)
    hidden[0, 0] = abs(logit + 1.0)
    hidden.requires_grad_()
    sigma, _ = decoders.density(hidden)
    sigma.sum().backward()
    assert hidden.grad is not None
    assert sigma.item() == pytest.approx(density, rel=1e-4)
    assert abs(hidden.grad[0, 0].item()) == pytest.approx(gradient, rel=1e-4)
