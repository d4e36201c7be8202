"""Hits of one tile of an image, collected and sorted in cache: what selection and the fast frame both start from.

A tile is small enough that its hit table stays in a core's own cache. Conics give each anchor's pixel interval on
every scanline exactly (METHOD.md 5.1). Hits are found anchor by anchor, then dealt out to their rays and sorted there.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from orca.conventions import Float32Array, Float64Array

__all__ = [
    "TILE",
    "Footprints",
    "TileHits",
    "assign_tiles",
    "changed_tiles",
    "collect_tile",
    "hit_bound",
    "layer_end",
    "new_tile_hits",
    "reaching",
    "tile_box",
    "tile_pixels",
]

TILE = 32  # side in pixels
_STEPS = (1750, 701, 301, 132, 57, 23, 1)  # of Shell's sort


class Footprints(NamedTuple):
    """Where anchors project to in one view.

    Attributes:
        conic: [N, 13], see `orca.render.conics`.
        box: pixel boxes, [N, 4].
        offset, member: anchors of tile i are ``member[offset[i] : offset[i + 1]]``, ascending.
    """

    conic: Float64Array
    box: NDArray[np.int32]
    offset: NDArray[np.int64]
    member: NDArray[np.int32]


class TileHits(NamedTuple):
    """Hits of one tile; those of ray r (row by row) are ``start[r] : start[r] + length[r]``, by (t, anchor).

    Attributes:
        start, length: [TILE * TILE].
        total: how many entries there are, [1].
        anchor, t, m2, a: one entry a hit, as in `orca.render.hits.HitList`.
        found: the same as they were found: ray, anchor and (t, m2, a).
    """

    start: NDArray[np.int32]
    length: NDArray[np.int32]
    total: NDArray[np.int64]
    anchor: NDArray[np.int32]
    t: Float32Array
    m2: Float32Array
    a: Float32Array
    found: tuple[NDArray[np.int32], NDArray[np.int32], Float32Array]


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def assign_tiles(box: NDArray[np.int32], size: tuple[int, int]) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Anchors whose pixel box meets each tile: offsets [tiles + 1] and anchor indices, ascending within a tile."""
    columns, rows = (size[0] + TILE - 1) // TILE, (size[1] + TILE - 1) // TILE
    offset = np.zeros(columns * rows + 1, np.int64)
    for i in range(box.shape[0]):
        if box[i, 2] > box[i, 0] and box[i, 3] > box[i, 1]:
            for y in range(box[i, 1] // TILE, (box[i, 3] - 1) // TILE + 1):
                for x in range(box[i, 0] // TILE, (box[i, 2] - 1) // TILE + 1):
                    offset[y * columns + x + 1] += 1
    for b in range(columns * rows):
        offset[b + 1] += offset[b]
    member = np.empty(offset[columns * rows], np.int32)
    cursor = offset[:-1].copy()
    for i in range(box.shape[0]):
        if box[i, 2] > box[i, 0] and box[i, 3] > box[i, 1]:
            for y in range(box[i, 1] // TILE, (box[i, 3] - 1) // TILE + 1):
                for x in range(box[i, 0] // TILE, (box[i, 2] - 1) // TILE + 1):
                    b = y * columns + x
                    member[cursor[b]] = i
                    cursor[b] += 1
    return offset, member


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def tile_box(tile: int, size: tuple[int, int]) -> tuple[int, int, int, int]:
    """Pixel box (x0, y0, x1, y1) of a tile; tiles are numbered row by row."""
    columns = (size[0] + TILE - 1) // TILE
    x0, y0 = tile % columns * TILE, tile // columns * TILE
    return x0, y0, min(size[0], x0 + TILE), min(size[1], y0 + TILE)


def tile_pixels(tiles: NDArray[np.int64], size: tuple[int, int]) -> NDArray[np.int64]:
    """The pixels of some tiles of an image, ascending."""
    columns, rows = -(-size[0] // TILE), -(-size[1] // TILE)
    wanted = np.zeros((rows, columns), bool)
    wanted.ravel()[tiles] = True
    return np.flatnonzero(wanted.repeat(TILE, 0).repeat(TILE, 1)[: size[1], : size[0]])


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def changed_tiles(box: NDArray[np.int32], size: tuple[int, int]) -> NDArray[np.bool_]:
    """Which tiles the boxes reach into, [tiles]."""
    columns, rows = (size[0] + TILE - 1) // TILE, (size[1] + TILE - 1) // TILE
    changed = np.zeros(columns * rows, np.bool_)
    for i in range(box.shape[0]):
        if box[i, 2] > box[i, 0] and box[i, 3] > box[i, 1]:
            for y in range(box[i, 1] // TILE, (box[i, 3] - 1) // TILE + 1):
                for x in range(box[i, 0] // TILE, (box[i, 2] - 1) // TILE + 1):
                    changed[y * columns + x] = True
    return changed


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def reaching(box: NDArray[np.int32], tiles: NDArray[np.bool_], size: tuple[int, int]) -> NDArray[np.int64]:
    """The boxes that reach into some of the tiles, ascending."""
    columns = (size[0] + TILE - 1) // TILE
    left, top, right, bottom = len(tiles), len(tiles), 0, 0  # around the tiles: most boxes are far from all of them
    for tile in range(len(tiles)):
        if tiles[tile]:
            left, right = min(left, tile % columns), max(right, tile % columns + 1)
            top, bottom = min(top, tile // columns), max(bottom, tile // columns + 1)
    x_low, y_low, x_high, y_high = left * TILE, top * TILE, right * TILE, bottom * TILE
    near = np.empty(box.shape[0], np.bool_)
    for i in range(box.shape[0]):  # without a branch: one that cannot be foretold costs more than it saves
        near[i] = (box[i, 0] < x_high) & (box[i, 2] > x_low) & (box[i, 1] < y_high) & (box[i, 3] > y_low)
    found, n = np.empty(near.sum(), np.int64), 0
    for k in np.flatnonzero(near):
        x0, y0, x1, y1 = box[k]
        inside = False
        for y in range(max(top, y0 // TILE), min(bottom, (y1 - 1) // TILE + 1)):
            for x in range(max(left, x0 // TILE), min(right, (x1 - 1) // TILE + 1)):
                inside |= tiles[y * columns + x]
        if inside and x1 > x0 and y1 > y0:
            found[n] = k
            n += 1
    return found[:n]


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def hit_bound(tiles: NDArray[np.int64], where: Footprints, size: tuple[int, int]) -> int:
    """None of the tiles has more hits than this: the pixels in its anchors' boxes."""
    most = 0
    for tile in tiles:
        x0, y0, x1, y1 = tile_box(tile, size)
        total = 0
        for k in range(where.offset[tile], where.offset[tile + 1]):
            i = where.member[k]
            wide = min(where.box[i, 2], x1) - max(where.box[i, 0], x0)
            total += wide * (min(where.box[i, 3], y1) - max(where.box[i, 1], y0))
        most = max(most, total)
    return most


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def new_tile_hits(capacity: int) -> TileHits:
    """Room for the hits of any one tile that has at most ``capacity``."""
    n, rays = max(1, capacity), TILE * TILE
    return TileHits(
        np.empty(rays, np.int32),
        np.empty(rays, np.int32),
        np.zeros(1, np.int64),
        np.empty(n, np.int32),
        np.empty(n, np.float32),
        np.empty(n, np.float32),
        np.empty(n, np.float32),
        (np.empty(n, np.int32), np.empty(n, np.int32), np.empty((n, 3), np.float32)),
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def collect_tile(
    tile: int,
    size: tuple[int, int],
    where: Footprints,
    limits: tuple[float, float],
    most: int,
    newest: int,
    hits: TileHits,
) -> int:
    """Fill ``hits`` with those of one tile, the ``most`` nearest of each ray; returns how many more there were.

    ``limits`` are chi2 and near. Rays that meet no anchor from ``newest`` on are left without hits.
    """
    box = tile_box(tile, size)
    rays = (box[2] - box[0]) * (box[3] - box[1])
    hits.length[:rays] = 0
    hits.total[0] = _find(tile, box, where, limits, hits.length, *hits.found)
    _deal(hits.total[0], rays, hits)
    if newest > 0:
        _keep_changed(rays, newest, hits)
    _sort(rays, hits)
    overflow = 0
    for r in range(rays):
        if hits.length[r] > most:
            overflow += hits.length[r] - most
            hits.length[r] = most
    return overflow


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _find(
    tile: int,
    tile_pixels: tuple[int, int, int, int],
    where: Footprints,
    limits: tuple[float, float],
    count: NDArray[np.int32],
    ray: NDArray[np.int32],
    anchor: NDArray[np.int32],
    values: Float32Array,
) -> int:
    """Every hit, anchor by anchor, and how many each ray has; returns how many in all."""
    x0, y0, x1, y1 = tile_pixels
    chi2, near = limits
    conic, box, n = where.conic, where.box, 0
    for k in range(where.offset[tile], where.offset[tile + 1]):
        i = where.member[k]
        px, py, t0, a0, h0, h1 = conic[i, 0], conic[i, 1], conic[i, 2], conic[i, 3], conic[i, 4], conic[i, 5]
        e00, e01, e11 = conic[i, 6], conic[i, 7], conic[i, 8]
        g00, g01, g11 = conic[i, 9], conic[i, 10], conic[i, 11]
        no_ellipse = conic[i, 12] > 0.0  # it reaches `near`: tested pixel by pixel
        tt = t0 * t0
        qa, qb, qc = tt * g00 - chi2 * e00, tt * g01 - chi2 * e01, tt * g11 - chi2 * e11
        per_qa = 1.0 / qa if qa != 0.0 else 0.0
        left, right = float(max(box[i, 0], x0)), float(min(box[i, 2], x1) - 1)
        for y in range(max(box[i, 1], y0), min(box[i, 3], y1)):
            dy = y + 0.5 - py
            low, high = left, right
            if not no_ellipse:
                b = qb * dy - chi2 * h0
                disc = b * b - qa * (qc * dy * dy - 2.0 * chi2 * h1 * dy - chi2 * a0)
                if not disc >= 0.0:  # so that a NaN is no hit either
                    continue
                root = np.sqrt(disc)
                low, high = max(px - 0.5 + (-b - root) * per_qa, left), min(px - 0.5 + (-b + root) * per_qa, right)
                if not high >= low:
                    continue
            row = (y - y0) * (x1 - x0) - x0
            for x in range(int(np.ceil(low)), int(np.floor(high)) + 1):
                dx = x + 0.5 - px
                hd = h0 * dx + h1 * dy
                a = a0 + 2.0 * hd + e00 * dx * dx + 2.0 * e01 * dx * dy + e11 * dy * dy
                scale = t0 / a
                t, m2 = scale * (a0 + hd), scale * t0 * (g00 * dx * dx + 2.0 * g01 * dx * dy + g11 * dy * dy)
                if no_ellipse and not (m2 <= chi2 and t > near):
                    continue
                ray[n], anchor[n] = row + x, i
                values[n, 0], values[n, 1], values[n, 2] = t, max(0.0, m2), a
                count[row + x] += 1
                n += 1
    return n


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _deal(total: int, rays: int, hits: TileHits) -> None:
    """Each hit to its ray, in the order found: ascending anchors."""
    ray, anchor, values = hits.found
    start, at = hits.start, 0
    for r in range(rays):
        start[r] = at
        at += hits.length[r]
    for k in range(total):
        to = start[ray[k]]
        start[ray[k]] = to + 1
        hits.anchor[to], hits.t[to], hits.m2[to], hits.a[to] = anchor[k], values[k, 0], values[k, 1], values[k, 2]
    for r in range(rays):
        start[r] -= hits.length[r]


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _keep_changed(rays: int, newest: int, hits: TileHits) -> None:
    """Take the hits from rays that meet no anchor from ``newest`` on: anchors ascend, so a ray's last one tells."""
    for r in range(rays):
        if hits.length[r] > 0 and hits.anchor[hits.start[r] + hits.length[r] - 1] < newest:
            hits.length[r] = 0


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _sort(rays: int, hits: TileHits) -> None:
    """Sort the hits of every ray by (t, anchor): Shell's sort, which on few hits is insertion."""
    anchor, t, m2, a = hits.anchor, hits.t, hits.m2, hits.a
    for r in range(rays):
        low, end = hits.start[r], hits.start[r] + hits.length[r]
        for step in _STEPS:
            for i in range(low + step, end):
                of, depth, distance, precision = anchor[i], t[i], m2[i], a[i]
                j, k = i, i - step
                while k >= low and (t[k] > depth or (t[k] == depth and anchor[k] > of)):
                    anchor[j], t[j], m2[j], a[j] = anchor[k], t[k], m2[k], a[k]
                    j, k = k, k - step
                anchor[j], t[j], m2[j], a[j] = of, depth, distance, precision


@numba.njit(cache=True, inline="always", error_model="numpy")  # type: ignore[untyped-decorator]
def layer_end(t: Float32Array, precision: Float32Array, first: int, end: int, gaps: tuple[float, float]) -> int:
    """Past-the-end hit of the surface that starts at hit ``first`` of a ray whose hits end at ``end``.

    The rule of `orca.render.aggregation.layer_index`: a gap of more than ``gaps[0]`` times the larger of the two
    standard deviations along the ray, and of more than ``gaps[1]`` of the depth, parts two surfaces.
    """
    k = first + 1
    while k < end:
        gap = t[k] - t[k - 1]
        if gap > gaps[1] * t[k - 1] and gap * gap * min(precision[k], precision[k - 1]) > gaps[0] * gaps[0]:
            break
        k += 1
    return k
