"""The compiled closest approach against the same in torch operations: values, gradients, and special cases."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from orca.anchors import GaussianAnchors
from orca.render.approach import closest_approach, eager_closest_approach
from tests.orca.anchor_scenes import random_anchors, random_camera

RAYS, HITS = 40, 300


def _hits(seed: int) -> tuple[GaussianAnchors, tuple[Tensor, Tensor, Tensor, Tensor]]:
    g = torch.Generator().manual_seed(seed)
    camera = random_camera(seed, 20, 20)
    anchors = random_anchors(seed, 50, camera, (0.01, 0.5), (0.8, 5.0))
    # Quaternions of any length, as training leaves them.
    anchors = replace(anchors, quaternions=anchors.quaternions * (0.2 + torch.rand(50, 1, generator=g)))
    directions = torch.nn.functional.normalize(torch.randn(RAYS, 3, generator=g), dim=-1)
    anchor, ray = torch.randint(50, (HITS,), generator=g), torch.randint(RAYS, (HITS,), generator=g)
    return anchors, (torch.from_numpy(camera.center).float(), directions, anchor, ray)


def _with_gradients(anchors: GaussianAnchors) -> tuple[GaussianAnchors, list[Tensor]]:
    leaves = [x.clone().requires_grad_() for x in (anchors.means, anchors.log_variances, anchors.quaternions)]
    means, log_variances, quaternions = leaves
    return replace(anchors, means=means, log_variances=log_variances, quaternions=quaternions), leaves


def _double(anchors: GaussianAnchors) -> GaussianAnchors:
    return replace(
        anchors,
        means=anchors.means.double(),
        log_variances=anchors.log_variances.double(),
        quaternions=anchors.quaternions.double(),
    )


@pytest.mark.parametrize("seed", range(4))
def test_values_are_those_of_float64(seed: int) -> None:
    anchors, given = _hits(seed)
    exact = eager_closest_approach(_double(anchors), *given)
    for mine, truth in zip(closest_approach(anchors, *given), exact, strict=True):
        assert mine.dtype == torch.float32
        torch.testing.assert_close(mine, truth.float(), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_gradients_are_those_of_float64(seed: int) -> None:
    anchors, given = _hits(seed)
    g = torch.Generator().manual_seed(seed)
    weights = [torch.randn(HITS, generator=g, dtype=torch.float64) for _ in range(3)]
    found = []
    for of, function in ((anchors, closest_approach), (_double(anchors), eager_closest_approach)):
        with_graph, leaves = _with_gradients(of)
        t, m2, a = (x.double() for x in function(with_graph, *given))
        # Of comparable size, so that none hides another.
        loss = (weights[0] * t + weights[1] * torch.log1p(m2) + weights[2] * torch.log(a)).sum()
        found.append(torch.autograd.grad(loss, leaves))
    for mine, truth in zip(*found, strict=True):
        assert float((mine.double() - truth).norm() / truth.norm()) < 1e-5


def test_no_gradient_that_nobody_asked_for_and_no_hits() -> None:
    anchors, given = _hits(0)
    with_graph, (means, log_variances, quaternions) = _with_gradients(anchors)
    none = torch.zeros(0, dtype=torch.long)
    t, m2, a = closest_approach(with_graph, given[0], given[1], none, none)
    assert t.shape == m2.shape == a.shape == (0,)
    (t.sum() + m2.sum() + a.sum()).backward()
    for leaf in (means, log_variances, quaternions):
        assert leaf.grad is not None
        assert not leaf.grad.any()


def test_only_depth_may_be_used() -> None:
    anchors, given = _hits(1)
    with_graph, leaves = _with_gradients(anchors)
    closest_approach(with_graph, *given)[0].sum().backward()
    exact, exact_leaves = _with_gradients(_double(anchors))
    eager_closest_approach(exact, *given)[0].sum().backward()
    for mine, truth in zip(leaves, exact_leaves, strict=True):
        assert mine.grad is not None
        assert truth.grad is not None
        assert float((mine.grad - truth.grad).norm() / truth.grad.norm()) < 1e-5
