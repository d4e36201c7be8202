"""The fast renderer for the CPU: numba for aggregation and compositing, cache-sized torch GEMMs for the decoders.

Gives the answer of `orca.render.reference` (a test holds them together). The first density layer is linear and the
aggregation weights sum to one, so it is applied once per anchor, before aggregation (METHOD.md 5.3).
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from orca.camera import Camera
from orca.config import RenderConfig
from orca.conventions import Float32Array
from orca.field.decoders import Decoders
from orca.render.hits import HitList
from orca.threads import kernel, map_on_cores

__all__ = ["Sampling", "aggregate", "composite_samples", "decode", "sample_alphas", "view_directions"]

_CHUNK = 2048  # rows per GEMM: small enough for the cache, large enough for full speed


@dataclass(frozen=True, eq=False)
class Sampling:
    """Samples of all rays in one compressed table; those of ray r are ``start[r] : start[r + 1]``.

    Attributes:
        start: [R + 1] int64.
        t: depth, [S] float32.
        opacity: a^, [S] float32.
        features: aggregated features (or first-layer outputs), [S, C] float32.
        row: first hit row of each sample, [S] int64.
        members: how many hits follow ``row`` in the same sample (layered) or 1 (per hit), [S] int32.
    """

    start: NDArray[np.int64]
    t: Float32Array
    opacity: Float32Array
    features: Float32Array
    row: NDArray[np.int64]
    members: NDArray[np.int32]

    @property
    def ray(self) -> NDArray[np.int64]:
        """Ray of each sample, [S]."""
        return np.repeat(np.arange(len(self.start) - 1), np.diff(self.start))


def aggregate(hits: HitList, opacity: Float32Array, carried: Float32Array, config: RenderConfig) -> Sampling:
    """Aggregate what anchors carry into samples.

    Args:
        hits: sorted hits of all rays.
        opacity: sigmoid(omega) per anchor, [N].
        carried: features or first-layer outputs per anchor, [N, C].
        config: decoding mode, window and layer gaps.
    """
    gaps = (config.layer_gap_sigmas, config.layer_gap_relative)
    table = (hits.start, hits.count, hits.anchor, hits.t_hit, hits.m2, hits.precision)
    layered = config.decode == "layered"
    start = _count_samples(hits.start, hits.count, hits.t_hit, hits.precision, gaps, layered)
    if layered:
        return Sampling(start, *_aggregate_layers(*table, opacity, carried, gaps, start))
    return Sampling(start, *_aggregate_hits(*table, opacity, carried, gaps, start, config.window))


@numba.njit(cache=True, inline="always")  # type: ignore[untyped-decorator]
def _starts_layer(t: float, t_before: float, a: float, a_before: float, gaps: tuple[float, float]) -> bool:
    reach = max(gaps[0] / np.sqrt(max(min(a, a_before), 1e-30)), gaps[1] * t_before)
    return bool(t - t_before > reach)


@kernel()
def _count_samples(
    start: NDArray[np.int64],
    count: NDArray[np.int32],
    t_hit: Float32Array,
    precision: Float32Array,
    gaps: tuple[float, float],
    layered: bool,
) -> NDArray[np.int64]:
    """Offsets of the samples of each ray, [R + 1]."""
    rays = start.shape[0]
    out = np.zeros(rays + 1, np.int64)
    for r in numba.prange(rays):
        n = count[r]
        if layered:
            layers = 1 if n > 0 else 0
            for k in range(start[r] + 1, start[r] + n):
                if _starts_layer(t_hit[k], t_hit[k - 1], precision[k], precision[k - 1], gaps):
                    layers += 1
            n = layers
        out[r + 1] = n
    for r in range(rays):
        out[r + 1] += out[r]
    return out


@kernel(fastmath={"contract", "reassoc", "nsz"})
def _aggregate_layers(
    start: NDArray[np.int64],
    count: NDArray[np.int32],
    anchor: NDArray[np.int32],
    t_hit: Float32Array,
    m2: Float32Array,
    precision: Float32Array,
    opacity: Float32Array,
    carried: Float32Array,
    gaps: tuple[float, float],
    sample_start: NDArray[np.int64],
) -> tuple[Float32Array, Float32Array, Float32Array, NDArray[np.int64], NDArray[np.int32]]:
    """Per layer: w_j = softmax(-m2_j / 2), t = sum w t_j, a^ = sum w exp(-m2_j / 2) sigmoid(omega_j), f^ = sum w f."""
    total, width = sample_start[-1], carried.shape[1]
    t_out, a_out = np.empty(total, np.float32), np.empty(total, np.float32)
    f_out = np.empty((total, width), np.float32)
    row_out, members = np.empty(total, np.int64), np.empty(total, np.int32)
    for r in numba.prange(start.shape[0]):
        s, k, end = sample_start[r], start[r], start[r] + count[r]
        while k < end:
            first = k
            k += 1
            while k < end and not _starts_layer(t_hit[k], t_hit[k - 1], precision[k], precision[k - 1], gaps):
                k += 1
            norm, a_sum, t_sum = np.float32(0), np.float32(0), np.float32(0)
            accumulated = f_out[s]
            accumulated[:] = 0
            for j in range(first, k):
                e = np.exp(np.float32(-0.5) * m2[j])
                norm += e
                a_sum += e * e * opacity[anchor[j]]
                t_sum += e * t_hit[j]
                source = carried[anchor[j]]
                for c in range(width):
                    accumulated[c] += e * source[c]
            scale = np.float32(1) / norm
            for c in range(width):
                accumulated[c] *= scale
            t_out[s], a_out[s] = t_sum * scale, a_sum * scale
            row_out[s], members[s] = first, k - first
            s += 1
    return t_out, a_out, f_out, row_out, members


@kernel(fastmath={"contract", "reassoc", "nsz"})
def _aggregate_hits(
    start: NDArray[np.int64],
    count: NDArray[np.int32],
    anchor: NDArray[np.int32],
    t_hit: Float32Array,
    m2: Float32Array,
    precision: Float32Array,
    opacity: Float32Array,
    carried: Float32Array,
    gaps: tuple[float, float],
    sample_start: NDArray[np.int64],
    window: int,
) -> tuple[Float32Array, Float32Array, Float32Array, NDArray[np.int64], NDArray[np.int32]]:
    """Per hit k: w_kj = softmax_j(-D_kj / 2) over its window, D_kj = m2_j + a_j (t_k - t_j)^2."""
    total, width = sample_start[-1], carried.shape[1]
    t_out, a_out = np.empty(total, np.float32), np.empty(total, np.float32)
    f_out = np.empty((total, width), np.float32)
    row_out, members = np.empty(total, np.int64), np.empty(total, np.int32)
    for r in numba.prange(start.shape[0]):
        begin, end = start[r], start[r] + count[r]
        low, high = begin, begin
        for k in range(begin, end):
            s = sample_start[r] + k - begin
            if window >= 0:
                low, high = max(begin, k - window), min(end, k + window + 1)
            elif k >= high:
                low, high = k, k + 1
                while high < end and not _starts_layer(
                    t_hit[high], t_hit[high - 1], precision[high], precision[high - 1], gaps
                ):
                    high += 1
            nearest = m2[k]
            for j in range(low, high):
                dt = t_hit[k] - t_hit[j]
                nearest = min(nearest, m2[j] + precision[j] * dt * dt)
            norm, a_sum = np.float32(0), np.float32(0)
            accumulated = f_out[s]
            accumulated[:] = 0
            for j in range(low, high):
                dt = t_hit[k] - t_hit[j]
                distance = m2[j] + precision[j] * dt * dt
                e = np.exp(np.float32(-0.5) * (distance - nearest))
                norm += e
                a_sum += e * np.exp(np.float32(-0.5) * distance) * opacity[anchor[j]]
                source = carried[anchor[j]]
                for c in range(width):
                    accumulated[c] += e * source[c]
            scale = np.float32(1) / norm
            for c in range(width):
                accumulated[c] *= scale
            t_out[s], a_out[s] = t_hit[k], a_sum * scale
            row_out[s], members[s] = k, 1
    return t_out, a_out, f_out, row_out, members


def decode(decoders: Decoders, hidden: Float32Array, directions: Float32Array | None) -> tuple[Tensor, Tensor]:
    """Density [S] and colour [S, 3] of first-layer outputs [S, 64], in cache-sized chunks.

    One chunk per core beats two cores on one chunk: on small GEMMs torch's own threads wait for one another, by
    milliseconds when the machine is busy (measured: 80 GFLOP/s on one thread, 1 to 20 on two).
    """
    total = len(hidden)
    sigma, colour = torch.empty(total), torch.empty(total, 3)
    rows = torch.from_numpy(hidden)
    views = None if directions is None else torch.from_numpy(directions)

    def work(low: int) -> None:
        part = slice(low, min(total, low + _CHUNK))
        with torch.inference_mode():
            sigma[part], geo = decoders.density(rows[part])
            colour[part] = decoders.colour(geo, None if views is None else views[part])

    map_on_cores(work, range(0, total, _CHUNK))
    return sigma, colour


@kernel()
def composite_samples(
    start: NDArray[np.int64],
    sigma: Float32Array,
    opacity: Float32Array,
    colour: Float32Array,
    t: Float32Array,
) -> Float32Array:
    """Front-to-back quadrature of all rays: [R, 5] as rgb before background, accumulated alpha, depth."""
    out = np.zeros((start.shape[0] - 1, 5), np.float32)
    for r in numba.prange(start.shape[0] - 1):
        transmittance = np.float32(1)
        for s in range(start[r], start[r + 1]):
            through = np.exp(-sigma[s] * opacity[s])
            weight = transmittance * (np.float32(1) - through)
            for c in range(3):
                out[r, c] += weight * colour[s, c]
            out[r, 3] += weight
            out[r, 4] += weight * t[s]
            transmittance *= through
    return out


@kernel()
def sample_alphas(start: NDArray[np.int64], sigma: Float32Array, opacity: Float32Array) -> Float32Array:
    """T_s alpha_s of every sample, [S]: how much of its pixel a sample makes up."""
    out = np.empty(start[-1], np.float32)
    for r in numba.prange(start.shape[0] - 1):
        transmittance = np.float32(1)
        for s in range(start[r], start[r + 1]):
            through = np.exp(-sigma[s] * opacity[s])
            out[s] = transmittance * (np.float32(1) - through)
            transmittance *= through
    return out


def view_directions(camera: Camera, ray: NDArray[np.int64]) -> Float32Array:
    """Unit view directions of the rays of some samples, [S, 3]."""
    rays = camera.rays().astype(np.float32)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return np.asarray(rays[ray])
