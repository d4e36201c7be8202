"""One observation as a linear system: colour as a sparse map of what frozen anchors carry (METHOD.md 1.2)."""

from __future__ import annotations

from dataclasses import dataclass

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

    def scatter(self, rays: Float32Array) -> Float32Array:
        """Colours of rays [R, 3] at their samples, each times its share, [S, 3]."""
        out = np.empty((len(self.share), rays.shape[1]), np.float32)
        _scatter(len(rays), self.start, self.share, rays, out)
        return out


def linear_view(renderer: Renderer, *observed: Observation) -> LinearView:
    """The system of one observation, or of several stacked, from the hits of their rays."""
    parts = [_rows(renderer, o) for o in observed]
    samples, entries = np.zeros(1, np.int64), np.zeros(1, np.int64)
    for start, indptr, _, _, _ in parts:
        samples = np.concatenate([samples, start[1:] + samples[-1]])
        entries = np.concatenate([entries, indptr[1:] + entries[-1]])
    column, weight, opacity = (np.concatenate([p[i] for p in parts]) for i in (2, 3, 4))
    weights = SparseMatrix.build(entries, column, weight, len(renderer.means))
    sigma = _densities(renderer, weights)
    target = np.concatenate([o.colour for o in observed])
    return LinearView(weights, samples, _shares(samples, sigma, opacity), target)


def _densities(renderer: Renderer, weights: SparseMatrix) -> Float32Array:
    """Sigma of every sample, [S]."""
    carried = renderer.carried
    if len(carried) and bool((carried == carried[0]).all()):  # as after the analytic start: weights sum to one
        return np.full(len(weights.rows[0]) - 1, renderer.matrices.sigma(carried[:1])[0], np.float32)
    return renderer.matrices.sigma(weights.times(carried))


_Rows = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int32], Float32Array, Float32Array]


def _rows(renderer: Renderer, observation: Observation) -> _Rows:
    """Sample offsets of each ray, then weights as CSR, then a^ of each sample."""
    hits, config = renderer.hits(observation.camera), renderer.config
    start, count = hits.start[observation.rays], hits.count[observation.rays]
    gaps = (config.layer_gap_sigmas, config.layer_gap_relative)
    layered, window = config.decode == "layered", config.window
    values = (hits.t_hit, hits.m2, hits.precision)
    rays = len(start)
    offsets = np.zeros(rays + 1, np.int64), np.zeros(rays + 1, np.int64)
    _count(rays, start, count, hits.t_hit, hits.precision, gaps, layered, window, *offsets)
    samples, entries = (np.cumsum(counts, out=counts)[-1] for counts in offsets)
    indptr, a_hat = np.full(samples + 1, entries), np.empty(samples, np.float32)
    column, weight = np.empty(entries, np.int32), np.empty(entries, np.float32)
    rules = (gaps, layered, window)
    _fill(rays, start, count, hits.anchor, values, renderer.opacity, *rules, offsets, indptr, column, weight, a_hat)
    return offsets[0], indptr, column, weight, a_hat


@kernel()
def _count(
    first: int,
    last: int,
    start: NDArray[np.int64],
    count: NDArray[np.int32],
    t: Float32Array,
    precision: Float32Array,
    gaps: tuple[float, float],
    layered: bool,
    window: int,
    samples: NDArray[np.int64],
    entries: NDArray[np.int64],
) -> None:
    """How many samples each ray has and how many weights they have; those of ray r at r + 1, [R + 1]."""
    for r in range(first, last):
        low, end = start[r], start[r] + count[r]
        k, n, total = low, 0, 0
        while k < end:
            if layered or window < 0:
                after = layer_end(t, precision, k, end, gaps)
                n += 1 if layered else after - k
                total += after - k if layered else (after - k) * (after - k)
                k = after
            else:
                n += 1
                total += min(end, k + window + 1) - max(low, k - window)
                k += 1
        samples[r + 1], entries[r + 1] = n, total


@kernel()
def _fill(
    first: int,
    last: int,
    start: NDArray[np.int64],
    count: NDArray[np.int32],
    anchor: NDArray[np.int32],
    values: tuple[Float32Array, Float32Array, Float32Array],  # t*, m2, a
    opacity: Float32Array,
    gaps: tuple[float, float],
    layered: bool,
    window: int,
    offsets: tuple[NDArray[np.int64], NDArray[np.int64]],  # of each ray's samples, and of their weights
    indptr: NDArray[np.int64],
    column: NDArray[np.int32],
    weight: Float32Array,
    a_hat: Float32Array,
) -> None:
    """Weights of every sample over its hits as the three arrays of a CSR matrix, and a^ of every sample."""
    t, m2, precision = values
    sample_start, entry_start = offsets
    for r in range(first, last):
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


def _shares(start: NDArray[np.int64], sigma: Float32Array, opacity: Float32Array) -> Float32Array:
    """T alpha of every sample, [S]: how much of its pixel a sample makes up."""
    out = np.empty(start[-1], np.float32)
    _composite(len(start) - 1, start, sigma, opacity, out)
    return out


@kernel()
def _composite(
    first: int, end: int, start: NDArray[np.int64], sigma: Float32Array, opacity: Float32Array, out: Float32Array
) -> None:
    for r in range(first, end):
        transmittance = np.float32(1)
        for s in range(start[r], start[r + 1]):
            through = np.exp(-sigma[s] * opacity[s])
            out[s] = transmittance * (np.float32(1) - through)
            transmittance *= through


@kernel()
def _scatter(
    first: int, end: int, start: NDArray[np.int64], share: Float32Array, rays: Float32Array, out: Float32Array
) -> None:
    for r in range(first, end):
        for s in range(start[r], start[r + 1]):
            for c in range(rays.shape[1]):
                out[s, c] = share[s] * rays[r, c]
