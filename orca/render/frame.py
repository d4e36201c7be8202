"""One frame, tile by tile, without leaving the core's cache: select, sort, aggregate, decode, composite.

Rays of a tile are worked on in rounds, front to back: each round aggregates the next sample of every ray that still
lets light through, decodes all densities in one matrix product and the colours that count in three more. A ray
stops when less than `_OPAQUE` of the light is left, a sample's colour is skipped below `_UNSEEN`: together they
change no pixel by 1e-4. The answer is that of `orca.render.reference` (tests hold them together).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from orca.conventions import Float32Array
from orca.render.tiles import TILE, Footprints, TileHits, collect_tile, hit_bound, layer_end, new_tile_hits, tile_box

__all__ = ["FieldTables", "Mode", "render_tiles"]

_OPAQUE = np.float32(2e-5)
_UNSEEN = np.float32(5e-6)
_MAX_LOG_DENSITY = np.float32(15)
_FAST = {"contract", "reassoc", "nsz"}


class Mode(NamedTuple):
    """How hits become samples.

    Attributes:
        limits: chi2 and near.
        gaps: of layers, in sigmas and relative to depth.
        layered: one sample a surface, or one a hit.
        window: per hit, neighbours on either side; negative for the whole layer.
        most: hits kept of each ray.
        newest: only rays that meet an anchor from this one on are rendered; 0: all of them.
    """

    limits: tuple[float, float]
    gaps: tuple[float, float]
    layered: bool
    window: int
    most: int
    newest: int = 0


class FieldTables(NamedTuple):
    """What anchors carry and the matrices that decode it, each [inputs, outputs].

    Attributes:
        opacity: [N].
        carried: outputs of the first density layer, applied before aggregation, [N, H].
        density: [H, 1 + G], the density first.
        from_geo: [1 + G, C]; the density's row is zero.
        from_direction: [16, C].
        middle, last: [C, D], [D, 3].
        directions: spherical harmonics of every pixel's ray, [pixels, 16], or empty if they do not matter.
    """

    opacity: Float32Array
    carried: Float32Array
    density: Float32Array
    from_geo: Float32Array
    from_direction: Float32Array
    middle: Float32Array
    last: Float32Array
    directions: Float32Array


class _Rays(NamedTuple):
    """State of the rays of a tile: the next hit to aggregate, the layer it is in, and the light left."""

    cursor: NDArray[np.int32]
    layer: NDArray[np.int32]
    passed: Float32Array


class _Round(NamedTuple):
    """The samples of one round: their rays, depths, opacities, features; then what is decoded from them."""

    ray: NDArray[np.int32]
    t: Float32Array
    opacity: Float32Array
    hidden: Float32Array
    geo: Float32Array
    pixel: NDArray[np.int64]
    weight: Float32Array


@numba.njit(cache=True, inline="always", error_model="numpy")  # type: ignore[untyped-decorator]
def _exp(x: Any) -> Any:
    """exp in float32 to one unit in the last place, in plain arithmetic: a tenth of the library call, vectorised."""
    z = max(min(np.float32(x), np.float32(88)), np.float32(-87))
    k = np.floor(z * np.float32(1.44269504) + np.float32(0.5))
    r = z - k * np.float32(0.693359375) + k * np.float32(2.12194440e-4)
    p = np.float32(1.9875691500e-4) * r + np.float32(1.3981999507e-3)
    p = p * r + np.float32(8.3334519073e-3)
    p = p * r + np.float32(4.1665795894e-2)
    p = p * r + np.float32(1.6666665459e-1)
    p = p * r + np.float32(5.0000001201e-1)
    p = p * r * r + r + np.float32(1)
    return p * np.int32((np.int32(k) + 127) << 23).view(np.float32)


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _start_rays(count: int, rays: _Rays, hits: TileHits, samples: _Round) -> int:
    """All light left, at the first hit; returns how many of ``count`` rays hit anything."""
    n = 0
    for r in range(count):
        rays.cursor[r], rays.layer[r, 1], rays.passed[r] = hits.start[r], 0, 1
        if hits.length[r] > 0:
            samples.ray[n] = r
            n += 1
    return n


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _next_layers(rays: _Rays, hits: TileHits, samples: _Round, n: int, gaps: tuple[float, float]) -> None:
    """Where the surface that each ray's next hit lies on begins and ends."""
    for s in range(n):
        r = samples.ray[s]
        k = rays.cursor[r]
        if k >= rays.layer[r, 1]:
            rays.layer[r, 0] = k
            rays.layer[r, 1] = layer_end(hits.t, hits.a, k, hits.start[r] + hits.length[r], gaps)


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _responses(m2: Float32Array) -> None:
    """Replace squared distances by exp(-m2 / 2), in place."""
    for k in range(len(m2)):
        m2[k] = _exp(np.float32(-0.5) * m2[k])


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)  # type: ignore[untyped-decorator]
def _aggregate_layers(rays: _Rays, hits: TileHits, samples: _Round, n: int, field: FieldTables) -> None:
    """Per layer: w_j = softmax(-m2_j / 2), t = sum w t_j, a^ = sum w exp(-m2_j / 2) sigmoid(omega_j), f^ = sum w f."""
    carried, opacity, out = field.carried, field.opacity, samples.hidden
    channels = carried.shape[1]
    for s in range(n):
        r = samples.ray[s]
        norm, a_sum, t_sum = np.float32(0), np.float32(0), np.float32(0)
        for c in range(channels):
            out[s, c] = 0
        for j in range(rays.layer[r, 0], rays.layer[r, 1]):
            i, e = hits.anchor[j], hits.m2[j]  # `_responses` has been here
            norm += e
            a_sum += e * e * opacity[i]
            t_sum += e * hits.t[j]
            for c in range(channels):
                out[s, c] += e * carried[i, c]
        scale = np.float32(1) / norm
        for c in range(channels):
            out[s, c] *= scale
        samples.t[s], samples.opacity[s] = t_sum * scale, a_sum * scale
        rays.cursor[r] = rays.layer[r, 1]


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)  # type: ignore[untyped-decorator]
def _aggregate_hits(rays: _Rays, hits: TileHits, samples: _Round, n: int, field: FieldTables, window: int) -> None:
    """Per hit k: w_kj = softmax_j(-D_kj / 2) over its window, D_kj = m2_j + a_j (t_k - t_j)^2."""
    carried, opacity, out = field.carried, field.opacity, samples.hidden
    channels = carried.shape[1]
    for s in range(n):
        r = samples.ray[s]
        k, low, high = rays.cursor[r], rays.layer[r, 0], rays.layer[r, 1]
        if window >= 0:
            low, high = max(hits.start[r], k - window), min(hits.start[r] + hits.length[r], k + window + 1)
        t, nearest = hits.t[k], hits.m2[k]
        for j in range(low, high):
            nearest = min(nearest, hits.m2[j] + hits.a[j] * (t - hits.t[j]) ** 2)
        norm, a_sum = np.float32(0), np.float32(0)
        for c in range(channels):
            out[s, c] = 0
        for j in range(low, high):
            i, distance = hits.anchor[j], hits.m2[j] + hits.a[j] * (t - hits.t[j]) ** 2
            e = _exp(np.float32(-0.5) * (distance - nearest))
            norm += e
            a_sum += e * e * opacity[i]
            for c in range(channels):
                out[s, c] += e * carried[i, c]
        scale = np.float32(1) / norm
        for c in range(channels):
            out[s, c] *= scale
        samples.t[s], samples.opacity[s] = t, a_sum * scale * _exp(np.float32(-0.5) * nearest)
        rays.cursor[r] = k + 1


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _relu(x: Float32Array) -> None:
    for i in range(x.shape[0]):
        for c in range(x.shape[1]):
            x[i, c] = max(x[i, c], np.float32(0))


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _aggregate_round(rays: _Rays, hits: TileHits, samples: _Round, n: int, field: FieldTables, mode: Mode) -> None:
    """The next sample of each of the ``n`` rays of a round."""
    if mode.layered or mode.window < 0:
        _next_layers(rays, hits, samples, n, mode.gaps)
    if mode.layered:
        _aggregate_layers(rays, hits, samples, n, field)
    else:
        _aggregate_hits(rays, hits, samples, n, field, mode.window)


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _composite_round(
    rays: _Rays,
    hits: TileHits,
    samples: _Round,
    n: int,
    field: FieldTables,
    box: tuple[int, int, int, int],
    width: int,
    out: Float32Array,
) -> int:
    """Densities of a round, the light they take, their colours; returns how many rays go on."""
    hidden = samples.hidden[:n]
    _relu(hidden)
    decoded = np.dot(hidden, field.density)
    through = samples.opacity
    for s in range(n):
        sigma = _exp(min(decoded[s, 0] - np.float32(1), _MAX_LOG_DENSITY))
        through[s] = _exp(-sigma * through[s])
    seen, going = 0, 0
    for s in range(n):
        r = samples.ray[s]
        weight = rays.passed[r] * (np.float32(1) - through[s])
        rays.passed[r] *= through[s]
        pixel = (box[1] + r // (box[2] - box[0])) * width + box[0] + r % (box[2] - box[0])
        out[pixel, 3] += weight
        out[pixel, 4] += weight * samples.t[s]
        if weight >= _UNSEEN:
            for c in range(decoded.shape[1]):
                samples.geo[seen, c] = decoded[s, c]
            samples.pixel[seen], samples.weight[seen] = pixel, weight
            seen += 1
        if rays.passed[r] > _OPAQUE and rays.cursor[r] < hits.start[r] + hits.length[r]:
            samples.ray[going] = r
            going += 1
    _add_colours(samples.geo[:seen], samples.pixel[:seen], samples.weight[:seen], field, out)
    return going


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _add_colours(
    geo: Float32Array, pixel: NDArray[np.int64], weight: Float32Array, field: FieldTables, out: Float32Array
) -> None:
    """Decode the colours of some samples and add them to their pixels."""
    hidden = np.dot(geo, field.from_geo)
    if field.directions.shape[0] > 0:
        hidden += np.dot(field.directions[pixel], field.from_direction)
    _relu(hidden)
    hidden = np.dot(hidden, field.middle)
    _relu(hidden)
    colour = np.dot(hidden, field.last)
    flat = colour.ravel()
    for k in range(len(flat)):
        flat[k] = np.float32(1) / (np.float32(1) + _exp(-flat[k]))
    for s in range(len(pixel)):
        for c in range(3):
            out[pixel[s], c] += weight[s] * colour[s, c]


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def render_tiles(
    tiles: NDArray[np.int64],
    size: tuple[int, int],
    where: Footprints,
    field: FieldTables,
    mode: Mode,
    out: Float32Array,
    met: NDArray[np.bool_],
) -> int:
    """Render some tiles of an image; returns the number of hits beyond the cap.

    ``out`` [pixels, 5] receives rgb before background, accumulated alpha and sum T alpha t; zero at first. ``met``
    [pixels] becomes True where a ray was rendered, i.e. has hits.
    """
    full, overflow = TILE * TILE, 0
    hits = new_tile_hits(hit_bound(tiles, where, size))
    rays = _Rays(np.empty(full, np.int32), np.empty((full, 2), np.int32), np.empty(full, np.float32))
    samples = _Round(
        np.empty(full, np.int32),
        np.empty(full, np.float32),
        np.empty(full, np.float32),
        np.empty((full, field.carried.shape[1]), np.float32),
        np.empty((full, field.density.shape[1]), np.float32),
        np.empty(full, np.int64),
        np.empty(full, np.float32),
    )
    for tile in tiles:
        box = tile_box(tile, size)
        overflow += collect_tile(tile, size, where, mode.limits, mode.most, mode.newest, hits)
        if mode.layered:
            _responses(hits.m2[: hits.total[0]])
        n = _start_rays((box[2] - box[0]) * (box[3] - box[1]), rays, hits, samples)
        for s in range(n):
            r = samples.ray[s]
            met[(box[1] + r // (box[2] - box[0])) * size[0] + box[0] + r % (box[2] - box[0])] = True
        while n > 0:
            _aggregate_round(rays, hits, samples, n, field, mode)
            n = _composite_round(rays, hits, samples, n, field, box, size[0], out)
    return overflow
