"""The renderer in torch operations over flat hit tables: what gradient training runs on, and the path of CUDA.

The formulas are those of `orca.render.reference` (tests hold the two together, values and gradients). The reference
pads every ray to the longest and looks at every anchor; here a table has one row a hit, and only anchors that some ray
hits take part.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from orca.anchors import GaussianAnchors
from orca.camera import Camera
from orca.config import RenderConfig
from orca.field.decoders import Decoders
from orca.render.approach import closest_approach
from orca.render.reference import ray_tensors

__all__ = ["FlatHits", "render_flat"]


@dataclass(frozen=True, eq=False)
class FlatHits:
    """Hits of R rays, one row each, ray by ray and nearest first.

    Attributes:
        ray: ray of each hit, ascending, [H] int64.
        anchor: anchor of each hit, [H] int64.
        rays: R.
    """

    ray: Tensor
    anchor: Tensor
    rays: int


@dataclass(frozen=True, eq=False)
class _Table:
    """Continuous quantities of each hit: t*, m2, a, features [H, C] and opacity, and the surface it belongs to."""

    t: Tensor
    m2: Tensor
    precision: Tensor
    features: Tensor
    opacity: Tensor
    layer: Tensor


def render_flat(
    anchors: GaussianAnchors,
    decoders: Decoders,
    camera: Camera,
    pixels: Tensor,  # [R, 2] pixel positions
    hits: FlatHits,
    config: RenderConfig,
) -> tuple[Tensor, Tensor, Tensor]:
    """Colour without background [R, 3], accumulated alpha [R] and depth [R] of some rays of one camera.

    ``anchors`` may be those that ``hits`` refers to only; differentiable in all they hold and in the decoders.
    """
    origin, directions = ray_tensors(anchors, camera, pixels)
    table = _measure(anchors, origin, directions, hits, config)
    if config.decode == "layered":
        ray, t, opacity, features = _aggregate_layers(table, hits.ray)
    else:
        ray, t, (opacity, features) = hits.ray, table.t, _aggregate_hits(table, hits.ray, config)
    unit = None
    if decoders.use_direction:
        unit = torch.nn.functional.normalize(directions, dim=-1).index_select(0, ray)
    sigma, colour = decoders(features, unit)
    return _composite(ray, hits.rays, sigma * opacity, colour, t)


def _measure(
    anchors: GaussianAnchors, origin: Tensor, directions: Tensor, hits: FlatHits, config: RenderConfig
) -> _Table:
    """t*, m2 and a of every hit by the RIS formulas, what its anchor carries, and its layer."""
    t, m2, a = closest_approach(anchors, origin, directions, hits.anchor, hits.ray)
    carried = torch.cat([anchors.features, torch.sigmoid(anchors.opacity_logits)[:, None]], 1)
    carried = carried.index_select(0, hits.anchor)
    layer = _layers(t.detach(), a.detach(), hits, config)
    return _Table(t, m2, a, carried[:, :-1], carried[:, -1], layer)


def _layers(t: Tensor, precision: Tensor, hits: FlatHits, config: RenderConfig) -> Tensor:
    """Number of the surface of each hit over all rays, [H], ascending (see `orca.render.aggregation.layer_index`)."""
    sigma = precision.clamp_min(1e-30).rsqrt()
    reach = config.layer_gap_sigmas * torch.maximum(sigma[1:], sigma[:-1])
    reach = torch.maximum(reach, config.layer_gap_relative * t[:-1])
    breaks = (t[1:] - t[:-1] > reach) | (hits.ray[1:] != hits.ray[:-1])
    return torch.cat([torch.zeros_like(hits.ray[:1]), breaks.long().cumsum(0)])


def _sums(values: Tensor, index: Tensor, size: int) -> Tensor:
    """Sums of rows with the same index, [size, ...]."""
    return torch.zeros((size, *values.shape[1:]), dtype=values.dtype, device=values.device).index_add(0, index, values)


def _aggregate_layers(table: _Table, ray: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """One sample a surface: its ray [S], t [S], a^ [S] and f^ [S, C]."""
    size = int(table.layer[-1].item()) + 1 if len(table.layer) else 0
    response = torch.exp(-0.5 * table.m2)  # m2 <= chi2, so no row of weights vanishes
    weight = response / _sums(response, table.layer, size).index_select(0, table.layer)
    columns = [table.features, table.t[:, None], (response * table.opacity)[:, None]]
    summed = _sums(weight[:, None] * torch.cat(columns, 1), table.layer, size)
    rays = torch.zeros(size, dtype=torch.long, device=ray.device).index_copy(0, table.layer, ray)
    return rays, summed[:, -2], summed[:, -1], summed[:, :-2]


def _aggregate_hits(table: _Table, ray: Tensor, config: RenderConfig) -> tuple[Tensor, Tensor]:
    """One sample a hit k: a^ [H] and f^ [H, C] with w_kj = softmax_j(-D_kj / 2) over the window of k."""
    k, j = _layer_pairs(table.layer) if config.window < 0 else _window_pairs(ray, config.window)
    dt = table.t.index_select(0, k) - table.t.index_select(0, j)
    distance = table.m2.index_select(0, j) + table.precision.index_select(0, j) * dt * dt
    # The smallest distance of each window comes off before the exponential, as a softmax does it.
    least = torch.full_like(table.t, torch.inf).scatter_reduce(0, k, distance.detach(), "amin")
    response = torch.exp(-0.5 * (distance - least.index_select(0, k)))
    weight = response / _sums(response, k, len(ray)).index_select(0, k)
    opacity = weight * torch.exp(-0.5 * distance) * table.opacity.index_select(0, j)
    features = weight[:, None] * table.features.index_select(0, j)
    summed = _sums(torch.cat([features, opacity[:, None]], 1), k, len(ray))
    return summed[:, -1], summed[:, :-1]


def _window_pairs(ray: Tensor, window: int) -> tuple[Tensor, Tensor]:
    """Pairs (k, j) of hits of one ray with |k - j| <= window."""
    here = torch.arange(len(ray), device=ray.device)
    pairs = []
    for step in range(-window, window + 1):
        other = (here + step).clamp(0, max(0, len(ray) - 1))
        same = (other == here + step) & (ray[other] == ray)
        pairs.append(torch.stack([here[same], other[same]]))
    k, j = torch.cat(pairs, 1).unbind(0)
    return k, j


def _layer_pairs(layer: Tensor) -> tuple[Tensor, Tensor]:
    """All pairs (k, j) of hits of one layer."""
    sizes = torch.bincount(layer) if len(layer) else layer
    first = (sizes.cumsum(0) - sizes).index_select(0, layer)
    own = sizes.index_select(0, layer)  # how many partners each hit has
    k = torch.arange(len(layer), device=layer.device).repeat_interleave(own)
    offset = torch.arange(len(k), device=layer.device) - (own.cumsum(0) - own).index_select(0, k)
    return k, first.index_select(0, k) + offset


def _composite(ray: Tensor, rays: int, depth_of: Tensor, colour: Tensor, t: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Front-to-back quadrature; ``depth_of`` [S] is sigma a^, the optical depth of each sample."""
    # Light left before each sample: exp(-sum of the optical depths in front). One running sum over all rays, in
    # float64 so that what a ray's own samples add is not lost in it.
    running = depth_of.double().cumsum(0)
    before = running - depth_of
    first = torch.ones_like(ray, dtype=torch.bool)
    first[1:] = ray[1:] != ray[:-1]
    start = before[first].index_select(0, first.long().cumsum(0) - 1) if len(ray) else before
    transmitted = torch.exp(-(before - start)).to(depth_of.dtype)
    weight = transmitted * -torch.expm1(-depth_of)
    columns = torch.cat([colour, torch.ones_like(t)[:, None], t[:, None]], 1)
    summed = _sums(weight[:, None] * columns, ray, rays)
    return summed[:, :3], summed[:, 3], summed[:, 4]
