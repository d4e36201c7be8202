"""Ray selection in torch operations, on any device: expand each anchor's pixel box, test, one sort on (pixel, t).

The same conics as the compiled selection (METHOD.md 5.1); tests hold the two together hit for hit.
"""

from __future__ import annotations

import torch
from torch import Tensor

from orca.anchors import GaussianAnchors
from orca.camera import Camera
from orca.config import RenderConfig
from orca.render.flat import FlatHits

__all__ = ["expand_hits"]


def expand_hits(anchors: GaussianAnchors, camera: Camera, config: RenderConfig) -> tuple[FlatHits, int]:
    """Hits of every pixel's ray, row by row, nearest first, on the anchors' device; and how many the cap cut off."""
    conic, box = _project(anchors, camera, config)
    size = (box[:, 2:] - box[:, :2]).clamp_min(0)
    area = size[:, 0] * size[:, 1]
    who = torch.arange(len(area), device=area.device).repeat_interleave(area)
    place = torch.arange(len(who), device=area.device) - (area.cumsum(0) - area).index_select(0, who)
    wide = size[:, 0].index_select(0, who)
    x = box[:, 0].index_select(0, who) + place % wide
    y = box[:, 1].index_select(0, who) + place // wide
    t, m2 = _closest_approach(conic.index_select(0, who), x, y)
    hit = (m2 <= config.chi2) & (t > config.near)
    pixel, who, t = (y * camera.width + x)[hit], who[hit], t[hit].float()
    # Positive floats sort like their bits: one key holds pixel and depth; a stable sort keeps ascending anchors.
    order = torch.sort((pixel << 32) | t.view(torch.int32).long(), stable=True).indices
    return _capped(pixel[order], who[order], camera.width * camera.height, config.max_hits)


def _capped(pixel: Tensor, who: Tensor, rays: int, most: int) -> tuple[FlatHits, int]:
    """The ``most`` nearest hits of each ray."""
    count = torch.bincount(pixel, minlength=rays)
    rank = torch.arange(len(pixel), device=pixel.device) - (count.cumsum(0) - count).index_select(0, pixel)
    keep = rank < most
    return FlatHits(pixel[keep], who[keep], rays), int((~keep).sum().item())


def _project(anchors: GaussianAnchors, camera: Camera, config: RenderConfig) -> tuple[Tensor, Tensor]:
    """Columns p (2), t0, a0, h (2), E (3), Gamma (3) of each anchor [N, 12], and its pixel box [N, 4]."""
    device = anchors.means.device
    pose, K, M = (
        torch.tensor(m.tolist(), dtype=torch.float64, device=device)
        for m in (camera.world_to_camera, camera.K, camera.pixel_to_ray())
    )
    seen = anchors.means.double() @ pose[:3, :3].T + pose[:3, 3]
    t0 = seen[:, 2]
    p = (seen @ K.T)[:, :2] / t0[:, None]
    AM = anchors.whitening().double() @ M
    v = AM[:, :, :2] @ p[:, :, None]
    v = v[:, :, 0] + AM[:, :, 2]
    a0, h = (v * v).sum(1), (AM[:, :, :2] * v[:, :, None]).sum(1)
    e00, e01, e11 = ((AM[:, :, i] * AM[:, :, j]).sum(1) for i, j in ((0, 0), (0, 1), (1, 1)))
    g00, g01, g11 = a0 * e00 - h[:, 0] ** 2, a0 * e01 - h[:, 0] * h[:, 1], a0 * e11 - h[:, 1] ** 2
    conic = torch.stack([p[:, 0], p[:, 1], t0, a0, h[:, 0], h[:, 1], e00, e01, e11, g00, g01, g11], 1)
    return conic, _boxes(conic, (camera.width, camera.height), config)


def _boxes(conic: Tensor, size: tuple[int, int], config: RenderConfig) -> Tensor:
    """Pixel boxes (x0, y0, x1, y1) of the footprints, [N, 4]; empty where there is none."""
    px, py, t0, a0, h0, h1, e00, e01, e11, g00, g01, g11 = conic.unbind(1)
    chi2, tt = config.chi2, conic[:, 2] ** 2
    b00, b01, b11 = tt * g00 - chi2 * e00, tt * g01 - chi2 * e01, tt * g11 - chi2 * e11
    det = b00 * b11 - b01 * b01
    ox, oy = chi2 * (b11 * h0 - b01 * h1) / det, chi2 * (b00 * h1 - b01 * h0) / det
    reach = chi2 * (a0 + h0 * ox + h1 * oy)
    rx, ry = (reach * b11 / det).clamp_min(0).sqrt(), (reach * b00 / det).clamp_min(0).sqrt()
    low = torch.stack([px + ox - rx, py + oy - ry], 1) - 0.5
    high = torch.stack([px + ox + rx, py + oy + ry], 1) - 0.5
    limit = torch.tensor(size, dtype=torch.float64, device=conic.device)
    low = torch.minimum(low.clamp_min(0).ceil(), limit)
    high = torch.minimum(high.clamp_min(-1), limit - 1).floor() + 1
    # An ellipsoid that reaches `near` has no ellipse that says it all: every pixel is tested.
    nears = (t0 - config.near) ** 2 * (g00 * g11 - g01 * g01) <= chi2 * a0 * (e00 * e11 - e01 * e01)
    everywhere = (nears | ~((b00 > 0) & (det > 0)))[:, None]
    low, high = torch.where(everywhere, 0.0, low), torch.where(everywhere, limit, high)
    there = (t0 > config.near) & (tt * a0 > chi2) & (everywhere[:, 0] | (reach > 0))
    high = torch.where(there[:, None], high, low)
    return torch.nan_to_num(torch.cat([low, high], 1)).long()


def _closest_approach(conic: Tensor, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """t* and m2 of pixels, one row of ``conic`` each."""
    px, py, t0, a0, h0, h1, e00, e01, e11, g00, g01, g11 = conic.unbind(1)
    dx, dy = x + 0.5 - px, y + 0.5 - py
    hd = h0 * dx + h1 * dy
    a = a0 + 2 * hd + e00 * dx * dx + 2 * e01 * dx * dy + e11 * dy * dy
    m2 = t0 * t0 * (g00 * dx * dx + 2 * g01 * dx * dy + g11 * dy * dy) / a
    return t0 * (a0 + hd) / a, m2.clamp_min(0)
