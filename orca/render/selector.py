"""Ray Intersection Selector: which anchors each ray hits, in depth order (METHOD.md 1, RIS).

`select` is exact and fast: conics give each anchor's pixel interval on every scanline, tiles are worked on in
parallel. `select_brute_force` is the definition, ray by ray and anchor by anchor; tests hold the two together.
"""

from __future__ import annotations

import numba
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from orca.anchors import GaussianAnchors
from orca.camera import Camera
from orca.config import RenderConfig
from orca.conventions import Float32Array
from orca.render.conics import project_anchors
from orca.render.hits import HitList
from orca.render.tiles import Footprints, assign_tiles, collect_tile, hit_bound, new_tile_hits, tile_box
from orca.threads import map_on_cores

__all__ = ["footprints", "ray_anchor_closest_approach", "select", "select_brute_force", "select_whitened"]

_PIECES = 16  # shares of the tiles that the cores take one at a time
_Columns = tuple[NDArray[np.int32], Float32Array, Float32Array, Float32Array]  # anchor, t*, m2, a


def ray_anchor_closest_approach(
    origin: Tensor,  # [..., 3]
    directions: Tensor,  # [..., 3]
    means: Tensor,  # [..., 3]
    whitening: Tensor,  # [..., 3, 3]
) -> tuple[Tensor, Tensor, Tensor]:
    """t* [...], m2 [...] and a = |A d|^2 [...] of rays against anchors: the RIS formulas of METHOD.md 1."""
    o = (whitening @ (origin - means)[..., None])[..., 0]
    d = (whitening @ directions[..., None])[..., 0]
    a = (d * d).sum(-1)
    t = -(o * d).sum(-1) / a
    closest = o + t[..., None] * d
    return t, (closest * closest).sum(-1), a


def select(anchors: GaussianAnchors, camera: Camera, config: RenderConfig) -> HitList:
    """Hits of every pixel's ray, row by row.

    Args:
        anchors: the anchors, on the CPU.
        camera: the view; crop it to select for a part of an image only.
        config: ``chi2``, ``near`` and ``max_hits`` are used.
    """
    return select_whitened(anchors.means.numpy(), anchors.whitening().numpy(), camera, config)


def select_whitened(means: Float32Array, whitening: Float32Array, camera: Camera, config: RenderConfig) -> HitList:
    """`select` for means [N, 3] and whitening matrices [N, 3, 3] that are already at hand."""
    size = (camera.width, camera.height)
    where, inside = footprints(means, whitening, camera, config)
    tiles = len(where.offset) - 1
    start, count = np.zeros(size[0] * size[1], np.int64), np.zeros(size[0] * size[1], np.int32)
    step = max(1, -(-tiles // _PIECES))

    def work(first: int) -> tuple[int, _Columns]:
        end, limits = min(tiles, first + step), (config.chi2, config.near)
        out: tuple[int, _Columns] = _collect(first, end, size, where, limits, config.max_hits, start, count)
        return out

    pieces = map_on_cores(work, range(0, tiles, step))
    base = 0
    for i, (_, columns) in enumerate(pieces):
        _shift(i * step, min(tiles, (i + 1) * step), size, start, base)
        base += len(columns[0])
    anchor, t_hit, m2, precision = (np.concatenate([p[1][c] for p in pieces]) for c in range(4))
    return HitList(start, count, anchor, t_hit, m2, precision, sum(p[0] for p in pieces), inside)


def footprints(
    means: Float32Array, whitening: Float32Array, camera: Camera, config: RenderConfig
) -> tuple[Footprints, int]:
    """Where anchors project to in a view, and how many are left out because the camera is inside of them."""
    size = (camera.width, camera.height)
    pose, rays = camera.world_to_camera, camera.pixel_to_ray()
    conic, box, inside = project_anchors(
        np.ascontiguousarray(means),
        np.ascontiguousarray(whitening),
        pose,
        camera.K,
        rays,
        size,
        config.chi2,
        config.near,
    )
    return Footprints(conic, box, *assign_tiles(box, size)), int(inside.sum())


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _collect(
    first: int,
    end: int,
    size: tuple[int, int],
    where: Footprints,
    limits: tuple[float, float],
    most: int,
    start: NDArray[np.int64],
    count: NDArray[np.int32],
) -> tuple[int, _Columns]:
    """Hits of some tiles one after another; sets ``start`` (from 0) and ``count`` of their rays."""
    hits = new_tile_hits(hit_bound(np.arange(first, end), where, size))
    capacity = np.int64(1024)
    anchor, values = np.empty(capacity, np.int32), np.empty((3, capacity), np.float32)
    used, overflow = 0, 0
    for tile in range(first, end):
        x0, y0, x1, y1 = tile_box(tile, size)
        overflow += collect_tile(tile, size, where, limits, most, 0, hits)
        n = hits.total[0]
        if used + n > capacity:
            capacity = 2 * (used + n)
            more_anchor, more_values = np.empty(capacity, np.int32), np.empty((3, capacity), np.float32)
            for k in range(used):  # slices would take seconds longer to compile
                more_anchor[k] = anchor[k]
                more_values[0, k], more_values[1, k], more_values[2, k] = values[0, k], values[1, k], values[2, k]
            anchor, values = more_anchor, more_values
        for k in range(n):
            anchor[used + k] = hits.anchor[k]
            values[0, used + k], values[1, used + k], values[2, used + k] = hits.t[k], hits.m2[k], hits.a[k]
        for y in range(y0, y1):
            for x in range(x0, x1):
                r = (y - y0) * (x1 - x0) + x - x0
                start[y * size[0] + x] = used + hits.start[r]
                count[y * size[0] + x] = hits.length[r]
        used += n
    return overflow, (anchor[:used], values[0, :used], values[1, :used], values[2, :used])


def _shift(first: int, end: int, size: tuple[int, int], start: NDArray[np.int64], base: int) -> None:
    for tile in range(first, end):
        x0, y0, x1, y1 = tile_box(tile, size)
        start.reshape(size[1], size[0])[y0:y1, x0:x1] += base


def select_brute_force(anchors: GaussianAnchors, camera: Camera, config: RenderConfig) -> HitList:
    """The definition of `select`: every ray against every anchor in float64. For tests; needs R x N memory."""
    origin = torch.from_numpy(camera.center)
    directions = torch.from_numpy(camera.rays())
    A = anchors.whitening().double()
    t, m2, a = ray_anchor_closest_approach(origin, directions[:, None], anchors.means.double()[None], A[None])
    centre_depth = anchors.means.double() @ torch.from_numpy(camera.rotation[2].copy()) + camera.translation[2]
    outside = (A @ (origin - anchors.means.double())[..., None])[..., 0].square().sum(-1) > config.chi2
    hit = (m2 <= config.chi2) & (t > config.near) & (outside & (centre_depth > config.near))[None]
    rays, who = hit.nonzero(as_tuple=True)
    order = np.lexsort((who.numpy(), t[hit].float().numpy(), rays.numpy()))
    kept = np.bincount(rays.numpy(), minlength=len(directions))
    start = np.concatenate([[0], np.cumsum(kept)[:-1]]).astype(np.int64)
    capped = np.minimum(kept, config.max_hits).astype(np.int32)
    t_hit, m2_hit, a_hit = (x[hit].float().numpy()[order] for x in (t, m2, a))
    inside = int((~outside & (centre_depth > config.near)).sum())
    anchor = who.numpy()[order].astype(np.int32)
    return HitList(start, capped, anchor, t_hit, m2_hit, a_hit, int((kept - capped).sum()), inside)
