"""The reference renderer: METHOD.md section 1, formula by formula, in torch; differentiable, on any device.

It is the oracle of the fast path and what gradient training runs on. It takes the hit lists that a selector found
(integers: nothing to differentiate) and recomputes every continuous quantity from the parameters.
"""

from __future__ import annotations

import torch
from torch import Tensor

from orca.anchors import GaussianAnchors
from orca.camera import Camera
from orca.config import RenderConfig
from orca.field.decoders import Decoders
from orca.render.aggregation import PaddedHits, aggregate
from orca.render.quadrature import composite
from orca.render.selector import ray_anchor_closest_approach

__all__ = ["gather_hits", "integrate", "ray_tensors", "render_rays"]


def gather_hits(
    anchors: GaussianAnchors,
    origin: Tensor,  # [3]
    directions: Tensor,  # [R, 3]
    hit_anchor: Tensor,  # [R, K] int64, -1 for none
) -> PaddedHits:
    """Evaluate t*, m2, a and look up features and opacity of given hits, differentiably."""
    valid = hit_anchor >= 0
    index = hit_anchor.clamp_min(0)
    t, m2, a = ray_anchor_closest_approach(
        origin, directions[:, None, :], anchors.means[index], anchors.whitening()[index]
    )
    # Padding sorts behind everything and weighs nothing.
    t, m2, a = torch.where(valid, t, t.detach().amax() + 1), torch.where(valid, m2, 0.0), torch.where(valid, a, 1.0)
    return PaddedHits(valid, t, m2, a, anchors.features[index], torch.sigmoid(anchors.opacity_logits)[index])


def render_rays(
    anchors: GaussianAnchors,
    decoders: Decoders,
    camera: Camera,
    pixels: Tensor,  # [R, 2] pixel positions
    hit_anchor: Tensor,  # [R, K]
    config: RenderConfig,
) -> tuple[Tensor, Tensor, Tensor]:
    """Colour without background [R, 3], accumulated alpha [R] and depth [R] of some rays of one camera."""
    origin, directions = ray_tensors(anchors, camera, pixels)
    return integrate(gather_hits(anchors, origin, directions, hit_anchor), decoders, directions, config)


def ray_tensors(anchors: GaussianAnchors, camera: Camera, pixels: Tensor) -> tuple[Tensor, Tensor]:
    """Origin [3] and directions [R, 3] (camera z = 1) of the rays of pixels [R, 2], where the anchors live."""
    like = anchors.means
    matrix = torch.as_tensor(camera.pixel_to_ray(), dtype=like.dtype, device=like.device)
    origin = torch.as_tensor(camera.center, dtype=like.dtype, device=like.device)
    homogeneous = torch.cat([pixels, torch.ones_like(pixels[:, :1])], 1).to(like.dtype)
    return origin, homogeneous @ matrix.T


def integrate(
    hits: PaddedHits, decoders: Decoders, directions: Tensor | None, config: RenderConfig
) -> tuple[Tensor, Tensor, Tensor]:
    """Aggregate, decode and composite given hits: colour without background [R, 3], alpha [R], depth [R].

    ``directions`` [R, 3] may be left out where the decoders do not use them.
    """
    samples = aggregate(hits, config)
    rays, k = samples.valid.shape
    unit = None
    if directions is not None:
        unit = torch.nn.functional.normalize(directions, dim=-1)[:, None, :].expand(rays, k, 3).reshape(-1, 3)
    sigma, colour = decoders(samples.features.flatten(0, 1), unit)
    sigma = torch.where(samples.valid, sigma.view(rays, k), 0.0)
    return composite(sigma, samples.opacity, colour.view(rays, k, 3), samples.t)
