"""The two bias-free decoders: feature to density and geometry code, geometry code to colour (METHOD.md 1)."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from orca.anchors import FEATURE_DIM

__all__ = [
    "COLOUR_CHANNELS",
    "DENSITY_CHANNEL",
    "SH_DIM",
    "Decoders",
    "analytic_decoders",
    "spherical_harmonics",
]

HIDDEN = 64
GEO_DIM = 15
SH_DIM = 16
LOG_DENSITY_MAX = 15.0
COLOUR_CHANNELS = 3  # feature channels 0..2 carry colour logits after the analytic initialisation
DENSITY_CHANNEL = 3  # ... and channel 3 carries the constant that the density is made from


class _TruncatedExp(torch.autograd.Function):
    """exp whose gradient is clamped, so that one overconfident sample cannot blow up a step."""

    @staticmethod
    def forward(ctx: torch.autograd.function.FunctionCtx, x: Tensor) -> Tensor:
        ctx.save_for_backward(x)
        return torch.exp(x.clamp(max=LOG_DENSITY_MAX))

    @staticmethod
    def backward(ctx: torch.autograd.function.FunctionCtx, grad: Tensor) -> Tensor:
        (x,) = ctx.saved_tensors  # type: ignore[attr-defined]
        return grad * torch.exp(x.clamp(-LOG_DENSITY_MAX, LOG_DENSITY_MAX))


def spherical_harmonics(directions: Tensor) -> Tensor:
    """Real spherical harmonics of degree 4 (bands 0 to 3), [S, 16], of unit directions [S, 3]."""
    x, y, z = directions.unbind(-1)
    xx, yy, zz = x * x, y * y, z * z
    terms = [
        torch.full_like(x, 0.28209479177387814),
        -0.4886025119029199 * y,
        0.4886025119029199 * z,
        -0.4886025119029199 * x,
        1.0925484305920792 * x * y,
        -1.0925484305920792 * y * z,
        0.31539156525252005 * (3 * zz - 1),
        -1.0925484305920792 * x * z,
        0.5462742152960396 * (xx - yy),
        0.5900435899266435 * y * (yy - 3 * xx),
        2.890611442640554 * x * y * z,
        0.4570457994644658 * y * (1 - 5 * zz),
        0.3731763325901154 * z * (5 * zz - 3),
        0.4570457994644658 * x * (1 - 5 * zz),
        1.445305721320277 * z * (xx - yy),
        0.5900435899266435 * x * (3 * yy - xx),
    ]
    return torch.stack(terms, -1)


class Decoders(nn.Module):
    """Density network 32 -> 64 -> 16 and colour network [SH 16 | geo 15] -> 64 -> 64 -> 3, no biases.

    With ``use_direction`` off the direction's place holds zeros: one camera cannot tell view dependence from
    texture and overfits it (METHOD.md 1.1).
    """

    def __init__(self, use_direction: bool = False, generator: torch.Generator | None = None) -> None:
        super().__init__()
        self.use_direction = use_direction
        self.density_in = nn.Linear(FEATURE_DIM, HIDDEN, bias=False)
        self.density_out = nn.Linear(HIDDEN, 1 + GEO_DIM, bias=False)
        self.colour_in = nn.Linear(SH_DIM + GEO_DIM, HIDDEN, bias=False)
        self.colour_mid = nn.Linear(HIDDEN, HIDDEN, bias=False)
        self.colour_out = nn.Linear(HIDDEN, 3, bias=False)
        if generator is not None:
            self.initialise(generator)

    def initialise(self, generator: torch.Generator) -> None:
        """Random weights, uniform within +-1/sqrt(fan in), from the caller's generator."""
        with torch.no_grad():
            for weight in self.parameters():
                bound = 1 / math.sqrt(weight.shape[1])
                weight.copy_((torch.rand(weight.shape, generator=generator) * 2 - 1) * bound)

    def density(self, hidden: Tensor) -> tuple[Tensor, Tensor]:
        """Density sigma [S] and geometry code [S, 15] from the first layer's output before ReLU, [S, 64].

        The first layer is linear and the aggregation weights sum to one, so it may be applied once per anchor,
        before the aggregation (METHOD.md 5.3).
        """
        out = self.density_out(torch.relu(hidden))
        return _TruncatedExp.apply(out[:, 0] - 1.0), out[:, 1:]

    def colour(self, geo: Tensor, directions: Tensor | None) -> Tensor:
        """RGB in [0, 1], [S, 3], from geometry codes [S, 15] and unit view directions [S, 3] (if used)."""
        hidden = geo @ self.colour_in.weight[:, SH_DIM:].T
        if self.use_direction and directions is not None:
            hidden = hidden + spherical_harmonics(directions) @ self.colour_in.weight[:, :SH_DIM].T
        return torch.sigmoid(self.colour_out(torch.relu(self.colour_mid(torch.relu(hidden)))))

    def forward(self, features: Tensor, directions: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Density [S] and colour [S, 3] of aggregated features [S, 32]."""
        sigma, geo = self.density(self.density_in(features))
        return sigma, self.colour(geo, directions)


def analytic_decoders(density: float, generator: torch.Generator, noise: float = 0.0) -> Decoders:
    """Decoders that pass feature channels 0..2 through to the colour logits (METHOD.md 1.2).

    A bias-free ReLU network represents a linear map exactly: x = relu(x) - relu(-x). Channel 3, held at 1 in every
    anchor, becomes the constant ``density``. All other weights start at zero, or at ``noise`` times a random
    initialisation so that gradients can reach them.

    Args:
        density: sigma where channel 3 is 1.
        generator: source of the random part.
        noise: scale of the random part; 0 keeps the map exact.
    """
    decoders = Decoders(generator=generator)
    with torch.no_grad():
        for weight in decoders.parameters():
            weight.mul_(noise)
        for c in range(COLOUR_CHANNELS):
            plus, minus = 2 * c, 2 * c + 1
            decoders.density_in.weight[plus, c] = 1.0
            decoders.density_in.weight[minus, c] = -1.0
            decoders.density_out.weight[1 + c, plus] = 1.0
            decoders.density_out.weight[1 + c, minus] = -1.0
            decoders.colour_in.weight[plus, SH_DIM + c] = 1.0
            decoders.colour_in.weight[minus, SH_DIM + c] = -1.0
            decoders.colour_mid.weight[plus, plus] = 1.0
            decoders.colour_mid.weight[minus, minus] = 1.0
            decoders.colour_out.weight[c, plus] = 1.0
            decoders.colour_out.weight[c, minus] = -1.0
        constant = 2 * COLOUR_CHANNELS
        decoders.density_in.weight[constant, DENSITY_CHANNEL] = 1.0
        decoders.density_out.weight[0, constant] = 1.0 + math.log(density)
    return decoders
