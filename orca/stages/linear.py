"""One observation as a linear system: colour as a sparse map of what frozen anchors carry (METHOD.md 1.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from orca.conventions import Float32Array
from orca.render.renderer import Renderer
from orca.render.tiles import layer_end
from orca.stages.observations import Observation
from orca.stages.sparse import SparseMatrix
from orca.threads import kernel

__all__ = ["LinearView", "linear_view"]


@dataclass(frozen=True, eq=False)
class LinearView:
    """Observations as a linear system.

    Attributes:
        weights: w, samples x anchors.
        start: samples of ray r are ``start[r] : start[r + 1]``, [R + 1].
        share: T alpha of each sample, [S].
        target: colours, [R, 3].
    """

    weights: SparseMatrix
    start: NDArray[np.int64]
    share: Float32Array
    target: Float32Array

    def gather(self, samples: Float32Array) -> Float32Array:
        """What the rays see of samples [S, 3]: sum T alpha x, [R, 3]."""
        return np.asarray(_gather(self.start, self.share, samples), np.float32)

    def scatter(self, rays: Float32Array) -> Float32Array:
        """The transpose of `gather`: [R, 3] to [S, 3]."""
        return np.asarray(_scatter(self.start, self.share, rays), np.float32)


def linear_view(renderer: Renderer, *observed: Observation) -> LinearView:
    """The system of one observation, or of several stacked, from the hits of their rays."""
    parts = [_rows(renderer, o) for o in observed]
    samples, entries = np.zeros(1, np.int64), np.zeros(1, np.int64)
    for start, indptr, _, _, _ in parts:
        samples = np.concatenate([samples, start[1:] + samples[-1]])
        entries = np.concatenate([entries, indptr[1:] + entries[-1]])
    column, weight, opacity = (np.concatenate([p[i] for p in parts]) for i in (2, 3, 4))
    weights = SparseMatrix.build(entries, column, weight, len(renderer.means))
    sigma = renderer.matrices.sigma(weights.times(renderer.carried))
    target = np.concatenate([o.colour for o in observed])
    return LinearView(weights, samples, _shares(samples, sigma, opacity), target)


_Rows = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int32], Float32Array, Float32Array]


def _rows(renderer: Renderer, observation: Observation) -> _Rows:
    """Sample offsets of each ray, then weights as CSR, then a^ of each sample."""
    hits, config = renderer.hits(observation.camera), renderer.config
    start, count = hits.start[observation.rays], hits.count[observation.rays]
    gaps = (config.layer_gap_sigmas, config.layer_gap_relative)
    layered, window = config.decode == "layered", config.window
    values = (hits.t_hit, hits.m2, hits.precision)
    sample_start, entry_start = _count(start, count, hits.t_hit, hits.precision, gaps, layered, window)
    filled = _fill(
        start, count, hits.anchor, values, renderer.opacity, gaps, layered, window, sample_start, entry_start
    )
    return (sample_start, *filled)


@kernel()
def _count(
    start: NDArray[np.int64],
    count: NDArray[np.int32],
    t: Float32Array,
    precision: Float32Array,
    gaps: tuple[float, float],
    layered: bool,
    window: int,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Offsets of each ray's samples and of their weights, both [R + 1]."""
    rays = len(start)
    samples, entries = np.zeros(rays + 1, np.int64), np.zeros(rays + 1, np.int64)
    for r in numba.prange(rays):
        low, end = start[r], start[r] + count[r]
        k, n, total = low, 0, 0
        while k < end:
            if layered or window < 0:
                last = layer_end(t, precision, k, end, gaps)
                n += 1 if layered else last - k
                total += last - k if layered else (last - k) * (last - k)
                k = last
            else:
                n += 1
                total += min(end, k + window + 1) - max(low, k - window)
                k += 1
        samples[r + 1], entries[r + 1] = n, total
    for r in range(rays):
        samples[r + 1] += samples[r]
        entries[r + 1] += entries[r]
    return samples, entries


@kernel()
def _fill(
    start: NDArray[np.int64],
    count: NDArray[np.int32],
    anchor: NDArray[np.int32],
    values: tuple[Float32Array, Float32Array, Float32Array],  # t*, m2, a
    opacity: Float32Array,
    gaps: tuple[float, float],
    layered: bool,
    window: int,
    sample_start: NDArray[np.int64],
    entry_start: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.int32], Float32Array, Float32Array]:
    """Weights of every sample over its hits as the three arrays of a CSR matrix, and a^ of every sample."""
    t, m2, precision = values
    total, entries = sample_start[-1], entry_start[-1]
    indptr, a_hat = np.empty(total + 1, np.int64), np.empty(total, np.float32)
    column, weight = np.empty(entries, np.int32), np.empty(entries, np.float32)
    indptr[total] = entries
    for r in numba.prange(len(start)):
        s, at = sample_start[r], entry_start[r]
        begin, end = start[r], start[r] + count[r]
        k, low, high = begin, begin, begin
        while k < end:
            if layered or window < 0:
                if k >= high:
                    low, high = k, layer_end(t, precision, k, end, gaps)
            else:
                low, high = max(begin, k - window), min(end, k + window + 1)
            norm, a_sum = np.float32(0), np.float32(0)
            for j in range(low, high):
                distance = m2[j]
                if not layered:
                    distance += precision[j] * (t[k] - t[j]) ** 2
                e = np.exp(np.float32(-0.5) * distance)
                column[at + j - low], weight[at + j - low] = anchor[j], e
                norm += e
                a_sum += e * e * opacity[anchor[j]]
            for j in range(low, high):
                weight[at + j - low] /= norm
            indptr[s], a_hat[s] = at, a_sum / norm
            s, at = s + 1, at + high - low
            k = high if layered else k + 1
    return indptr, column, weight, a_hat


@kernel()
def _shares(start: NDArray[np.int64], sigma: Float32Array, opacity: Float32Array) -> Float32Array:
    """T alpha of every sample, [S]: how much of its pixel a sample makes up."""
    out = np.empty(start[-1], np.float32)
    for r in numba.prange(len(start) - 1):
        transmittance = np.float32(1)
        for s in range(start[r], start[r + 1]):
            through = np.exp(-sigma[s] * opacity[s])
            out[s] = transmittance * (np.float32(1) - through)
            transmittance *= through
    return out


@kernel()
def _gather(start: NDArray[np.int64], share: Float32Array, samples: Float32Array) -> Float32Array:
    out = np.zeros((len(start) - 1, samples.shape[1]), np.float32)
    for r in numba.prange(len(start) - 1):
        for s in range(start[r], start[r + 1]):
            for c in range(samples.shape[1]):
                out[r, c] += share[s] * samples[s, c]
    return out


@kernel()
def _scatter(start: NDArray[np.int64], share: Float32Array, rays: Float32Array) -> Float32Array:
    out = np.empty((start[-1], rays.shape[1]), np.float32)
    for r in numba.prange(len(start) - 1):
        for s in range(start[r], start[r + 1]):
            for c in range(rays.shape[1]):
                out[s, c] = share[s] * rays[r, c]
    return out
