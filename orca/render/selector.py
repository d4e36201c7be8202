"""Ray Intersection Selector: which anchors each ray hits, in depth order (METHOD.md 1, RIS).

`select` is exact and fast: conics give each anchor's pixel interval on every scanline, bands of rows are worked on in
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
from orca.conventions import Float32Array, Float64Array
from orca.render.conics import project_anchors
from orca.render.hits import HitList
from orca.threads import kernel

__all__ = ["ray_anchor_closest_approach", "select", "select_brute_force"]

_BAND_ROWS = 8


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
    conic, box, inside = project_anchors(
        np.ascontiguousarray(means),
        np.ascontiguousarray(whitening),
        camera.world_to_camera,
        camera.K,
        camera.pixel_to_ray(),
        size,
        config.chi2,
        config.near,
    )
    offset, member = _bands(box, camera.height)
    start, count, anchor, t_hit, m2, precision = _intersect(conic, box, offset, member, size, config.chi2, config.near)
    overflow = _sort_rays(start, count, anchor, t_hit, m2, precision, config.max_hits)
    return HitList(start, count, anchor, t_hit, m2, precision, int(overflow), int(inside.sum()))


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _bands(box: NDArray[np.int32], height: int) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Anchors of each band of rows: offsets [B + 1] and anchor indices, in ascending order within a band."""
    bands = (height + _BAND_ROWS - 1) // _BAND_ROWS
    offset = np.zeros(bands + 1, np.int64)
    for i in range(box.shape[0]):
        if box[i, 2] > box[i, 0] and box[i, 3] > box[i, 1]:
            for b in range(box[i, 1] // _BAND_ROWS, (box[i, 3] - 1) // _BAND_ROWS + 1):
                offset[b + 1] += 1
    for b in range(bands):
        offset[b + 1] += offset[b]
    member = np.empty(offset[bands], np.int32)
    cursor = offset[:-1].copy()
    for i in range(box.shape[0]):
        if box[i, 2] > box[i, 0] and box[i, 3] > box[i, 1]:
            for b in range(box[i, 1] // _BAND_ROWS, (box[i, 3] - 1) // _BAND_ROWS + 1):
                member[cursor[b]] = i
                cursor[b] += 1
    return offset, member


# The next three read one row of the conic table. They live beside their caller, not beside the table's maker, since
# numba's cache watches the caller's file alone and would go on using what it inlined.


@numba.njit(cache=True, inline="always")  # type: ignore[untyped-decorator]
def _closest_approach(q: Float64Array, x: int, y: int) -> tuple[float, float, float]:
    """t*, m2 and a of the ray of pixel (x, y)."""
    dx, dy = x + 0.5 - q[0], y + 0.5 - q[1]
    hd = q[4] * dx + q[5] * dy
    a = q[3] + 2.0 * hd + q[6] * dx * dx + 2.0 * q[7] * dx * dy + q[8] * dy * dy
    quad = q[9] * dx * dx + 2.0 * q[10] * dx * dy + q[11] * dy * dy
    return q[2] * (q[3] + hd) / a, max(0.0, q[2] * q[2] * quad / a), a


@numba.njit(cache=True, inline="always")  # type: ignore[untyped-decorator]
def _is_hit(q: Float64Array, x: int, y: int, chi2: float, near: float) -> bool:
    """Whether pixel (x, y) of the footprint is a hit: true by construction unless the ellipsoid reaches ``near``."""
    if q[12] == 0.0:
        return True
    t, m2, _ = _closest_approach(q, x, y)
    return bool(m2 <= chi2 and t > near)


@numba.njit(cache=True, inline="always")  # type: ignore[untyped-decorator]
def _scanline(q: Float64Array, chi2: float, y: int, x0: int, x1: int) -> tuple[int, int]:
    """First and past-the-end pixel of the footprint on row ``y``, within [x0, x1)."""
    if q[12] > 0.0:  # reaches `near`: no ellipse to go by
        return x0, x1
    dy = y + 0.5 - q[1]
    tt = q[2] * q[2]
    a = tt * q[9] - chi2 * q[6]
    b = (tt * q[10] - chi2 * q[7]) * dy - chi2 * q[4]
    c = (tt * q[11] - chi2 * q[8]) * dy * dy - 2.0 * chi2 * q[5] * dy - chi2 * q[3]
    disc = b * b - a * c
    if not disc >= 0.0:  # so that a NaN is no hit either
        return 0, 0
    root = np.sqrt(disc)
    centre = q[0] - 0.5
    low = max(centre + (-b - root) / a, float(x0))
    high = min(centre + (-b + root) / a, float(x1 - 1))
    if not high >= low:
        return 0, 0
    return int(np.ceil(low)), int(np.floor(high)) + 1


@kernel()
def _intersect(
    conic: Float64Array,
    box: NDArray[np.int32],
    offset: NDArray[np.int64],
    member: NDArray[np.int32],
    size: tuple[int, int],
    chi2: float,
    near: float,
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.int32], Float32Array, Float32Array, Float32Array]:
    """Unsorted hits: counted in one sweep over the footprints, written in a second."""
    width, height = size
    bands = offset.shape[0] - 1
    count = np.zeros(width * height, np.int32)
    for band in numba.prange(bands):
        for k in range(offset[band], offset[band + 1]):
            i = member[k]
            q = conic[i]
            for y in range(max(box[i, 1], band * _BAND_ROWS), min(box[i, 3], (band + 1) * _BAND_ROWS)):
                first, last = _scanline(q, chi2, y, box[i, 0], box[i, 2])
                for x in range(first, last):
                    if _is_hit(q, x, y, chi2, near):
                        count[y * width + x] += 1
    start = np.zeros(width * height, np.int64)
    total = np.int64(0)
    for r in range(width * height):
        start[r] = total
        total += count[r]
    anchor = np.empty(total, np.int32)
    t_hit, m2, precision = np.empty(total, np.float32), np.empty(total, np.float32), np.empty(total, np.float32)
    for band in numba.prange(bands):
        low = band * _BAND_ROWS * width
        cursor = start[low : min(height, (band + 1) * _BAND_ROWS) * width].copy()
        for k in range(offset[band], offset[band + 1]):
            i = member[k]
            q = conic[i]
            for y in range(max(box[i, 1], band * _BAND_ROWS), min(box[i, 3], (band + 1) * _BAND_ROWS)):
                first, last = _scanline(q, chi2, y, box[i, 0], box[i, 2])
                for x in range(first, last):
                    if _is_hit(q, x, y, chi2, near):
                        row = cursor[y * width + x - low]
                        cursor[y * width + x - low] = row + 1
                        anchor[row] = i
                        t_hit[row], m2[row], precision[row] = _closest_approach(q, x, y)
    return start, count, anchor, t_hit, m2, precision


@kernel()
def _sort_rays(
    start: NDArray[np.int64],
    count: NDArray[np.int32],
    anchor: NDArray[np.int32],
    t_hit: Float32Array,
    m2: Float32Array,
    precision: Float32Array,
    max_hits: int,
) -> int:
    """Sort each ray's hits by (t_hit, anchor) in place, cap the count, return how many were cut off."""
    overflow = 0
    for r in numba.prange(start.shape[0]):
        low, n = start[r], count[r]
        for i in range(low + 1, low + n):
            j, b, t, m, a = i - 1, anchor[i], t_hit[i], m2[i], precision[i]
            while j >= low and (t_hit[j] > t or (t_hit[j] == t and anchor[j] > b)):
                anchor[j + 1], t_hit[j + 1], m2[j + 1] = anchor[j], t_hit[j], m2[j]
                precision[j + 1] = precision[j]
                j -= 1
            anchor[j + 1], t_hit[j + 1], m2[j + 1], precision[j + 1] = b, t, m, a
        if n > max_hits:
            overflow += n - max_hits
            count[r] = max_hits
    return overflow


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
