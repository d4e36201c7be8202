"""Volumetric quadrature without interval lengths (METHOD.md 1): alpha_k = 1 - exp(-sigma_k a^_k), front to back."""

from __future__ import annotations

import torch
from torch import Tensor

__all__ = ["composite"]


def composite(
    sigma: Tensor,  # [R, S], zero where there is no sample
    opacity: Tensor,  # [R, S]
    colour: Tensor,  # [R, S, 3]
    t: Tensor,  # [R, S]
) -> tuple[Tensor, Tensor, Tensor]:
    """Colour before background [R, 3], accumulated alpha [R] and depth sum T alpha t [R] of each ray."""
    transmitted = torch.exp(-sigma * opacity)
    alpha = 1 - transmitted
    before = torch.cat([torch.ones_like(transmitted[:, :1]), transmitted[:, :-1]], 1).cumprod(1)
    weight = before * alpha
    return (weight[..., None] * colour).sum(1), weight.sum(1), (weight * t).sum(1)
