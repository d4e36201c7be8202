"""Ray-Coherent Aggregation: the features of neighbouring hits of one ray become one sample (METHOD.md 1, RCA).

Plain torch over padded hits [R, K], differentiable in everything continuous; written to be read.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from orca.config import RenderConfig

__all__ = ["PaddedHits", "Samples", "aggregate", "layer_index"]

_EMPTY = -1e9  # stands for minus infinity in a softmax whose row may be all padding


@dataclass(frozen=True, eq=False)
class PaddedHits:
    """Hits of R rays, nearest first, padded to K columns.

    Attributes:
        valid: which entries are hits, [R, K] bool.
        t: t*, [R, K].
        m2: squared Mahalanobis distance, [R, K].
        precision: a_j = |A d|^2, [R, K].
        features: f_j, [R, K, C].
        opacity: sigmoid(omega_j), [R, K].
    """

    valid: Tensor
    t: Tensor
    m2: Tensor
    precision: Tensor
    features: Tensor
    opacity: Tensor


@dataclass(frozen=True, eq=False)
class Samples:
    """What is decoded and integrated along each ray, front to back.

    Attributes:
        valid: [R, S] bool.
        t: depth of the sample, [R, S].
        features: aggregated features f^, [R, S, C].
        opacity: aggregated opacity a^, [R, S].
    """

    valid: Tensor
    t: Tensor
    features: Tensor
    opacity: Tensor


def layer_index(hits: PaddedHits, config: RenderConfig) -> Tensor:
    """Number of the surface that each hit belongs to, [R, K], counted from the camera.

    A hit starts a new layer when it is further behind the previous hit than ``layer_gap_sigmas`` times the larger of
    the two standard deviations along the ray and than ``layer_gap_relative`` of the depth.
    """
    sigma = hits.precision.detach().clamp_min(1e-30).rsqrt()
    t = hits.t.detach()
    reach = config.layer_gap_sigmas * torch.maximum(sigma[:, 1:], sigma[:, :-1])
    reach = torch.maximum(reach, config.layer_gap_relative * t[:, :-1])
    breaks = (t[:, 1:] - t[:, :-1]) > reach
    first = torch.zeros_like(t[:, :1], dtype=torch.bool)
    return torch.cat([first, breaks], 1).long().cumsum(1)


def aggregate(hits: PaddedHits, config: RenderConfig) -> Samples:
    """Samples of each ray: one per hit ("per_hit") or one per surface ("layered")."""
    return _aggregate_layers(hits, config) if config.decode == "layered" else _aggregate_hits(hits, config)


def _aggregate_hits(hits: PaddedHits, config: RenderConfig) -> Samples:
    """w_kj = softmax_j(-D_kj / 2) over the window of hit k, D_kj = m2_j + a_j (t_k - t_j)^2 (exact on one ray)."""
    k = hits.t.shape[1]
    distance = hits.m2[:, None, :] + hits.precision[:, None, :] * (hits.t[:, :, None] - hits.t[:, None, :]) ** 2
    if config.window >= 0:
        position = torch.arange(k, device=hits.t.device)
        inside = ((position[:, None] - position[None, :]).abs() <= config.window)[None]
    else:
        layer = layer_index(hits, config)
        inside = layer[:, :, None] == layer[:, None, :]
    inside = inside & hits.valid[:, None, :] & hits.valid[:, :, None]
    weights = torch.softmax(torch.where(inside, -0.5 * distance, _EMPTY), dim=-1) * inside
    response = torch.where(inside, torch.exp(-0.5 * distance), 0.0) * hits.opacity[:, None, :]
    return Samples(hits.valid, hits.t, weights @ hits.features, (weights * response).sum(-1))


def _aggregate_layers(hits: PaddedHits, config: RenderConfig) -> Samples:
    """One sample a surface: every member is read at its own closest point, D_j = m2_j, t = sum_j w_j t_j."""
    layer = torch.where(hits.valid, layer_index(hits, config), -1)
    layers = int(layer.max().item()) + 1 if layer.numel() else 0
    member = layer[:, None, :] == torch.arange(max(1, layers), device=layer.device)[None, :, None]  # [R, S, K]
    weights = torch.softmax(torch.where(member, -0.5 * hits.m2[:, None, :], _EMPTY), dim=-1) * member
    response = torch.exp(-0.5 * hits.m2) * hits.opacity
    t = (weights * hits.t[:, None, :]).sum(-1)
    return Samples(member.any(-1), t, weights @ hits.features, (weights * response[:, None, :]).sum(-1))
