"""The closed-form fit: with frozen geometry, colour is a sparse linear map of what the anchors carry (METHOD.md 1.2).

With the analytic decoders a pixel's colour is sum_s T_s alpha_s sigmoid(sum_j w_sj c_j), c_j being the colour logits
of anchor j. Gauss-Newton on the logits; each step is a sparse least-squares problem, solved by a few conjugate-gradient
steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numba
import numpy as np
import torch
from numpy.typing import NDArray

from orca.anchors import GaussianAnchors
from orca.config import PlanarConfig, RenderConfig
from orca.conventions import Float32Array
from orca.field.decoders import COLOUR_CHANNELS, Decoders
from orca.render import fast
from orca.render.hits import HitList
from orca.render.renderer import Renderer
from orca.stages.observations import Observation
from orca.stages.sparse import SparseMatrix

__all__ = ["LinearView", "linear_view", "solve_colours"]


@dataclass(frozen=True, eq=False)
class LinearView:
    """One observation as a linear system.

    Attributes:
        weights: w, samples x anchors.
        gather: T alpha, rays x samples.
        target: colours, [R, 3].
    """

    weights: SparseMatrix
    gather: SparseMatrix
    target: Float32Array


def linear_view(renderer: Renderer, observation: Observation) -> LinearView:
    """Build the system of one observation from the hits of its rays."""
    hits = _some_rays(renderer.hits(observation.camera), observation.rays)
    samples = fast.aggregate(hits, renderer.opacity, renderer.hidden, renderer.config)
    sigma, _ = renderer.decoders.density(torch.from_numpy(samples.features))
    share = fast.sample_alphas(samples.start, sigma.detach().numpy(), samples.opacity)
    first, members = _members(hits, samples, renderer)
    indptr, column, value = _sample_weights(
        first, members, hits.anchor, hits.m2, hits.t_hit, hits.precision, samples.t, renderer.config.decode == "layered"
    )
    weights = SparseMatrix.build(indptr, column, value, len(renderer.means))
    gather = SparseMatrix.build(samples.start, np.arange(len(share), dtype=np.int32), share, len(share))
    return LinearView(weights, gather, observation.colour)


def _some_rays(hits: HitList, rays: NDArray[np.int64]) -> HitList:
    return HitList(
        hits.start[rays], hits.count[rays], hits.anchor, hits.t_hit, hits.m2, hits.precision, 0, hits.culled_inside
    )


def _members(hits: HitList, samples: fast.Sampling, renderer: Renderer) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """First hit row and number of hits that each sample aggregates over."""
    config = renderer.config
    if config.decode == "layered":
        return samples.row, samples.members
    if config.window < 0:  # each hit over the whole of its layer
        layers = fast.aggregate(hits, renderer.opacity, renderer.hidden[:, :1], replace(config, decode="layered"))
        return np.repeat(layers.row, layers.members), np.repeat(layers.members, layers.members)
    begin = hits.start[samples.ray]
    first = np.maximum(begin, samples.row - config.window)
    end = np.minimum(begin + hits.count[samples.ray], samples.row + config.window + 1)
    return first, (end - first).astype(np.int32)


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _sample_weights(
    row: NDArray[np.int64],
    members: NDArray[np.int32],
    anchor: NDArray[np.int32],
    m2: Float32Array,
    t_hit: Float32Array,
    precision: Float32Array,
    t: Float32Array,
    layered: bool,
) -> tuple[NDArray[np.int64], NDArray[np.int32], Float32Array]:
    """Softmax weights of every sample over its member hits, as the three arrays of a CSR matrix."""
    indptr = np.zeros(len(row) + 1, np.int64)
    for s in range(len(row)):
        indptr[s + 1] = indptr[s] + members[s]
    column, value = np.empty(indptr[-1], np.int32), np.empty(indptr[-1], np.float32)
    for s in range(len(row)):
        norm = np.float32(0)
        for k in range(members[s]):
            j = row[s] + k
            distance = m2[j] if layered else m2[j] + precision[j] * (t[s] - t_hit[j]) ** 2
            e = np.exp(np.float32(-0.5) * distance)
            column[indptr[s] + k], value[indptr[s] + k] = anchor[j], e
            norm += e
        for k in range(members[s]):
            value[indptr[s] + k] /= norm
    return indptr, column, value


def solve_colours(
    anchors: GaussianAnchors,
    decoders: Decoders,
    observed: Sequence[Observation],
    planar: PlanarConfig,
    render: RenderConfig,
) -> GaussianAnchors:
    """Anchors whose colour channels reproduce the observations best, in the least-squares sense.

    Starts from what the anchors carry; a fresh set (all zero) starts from the local mean of the target logits.
    """
    renderer = Renderer(anchors, decoders, render)
    views = [linear_view(renderer, o) for o in observed]
    colours = anchors.features[:, :COLOUR_CHANNELS].numpy().copy()
    if not colours.any():
        colours = _local_means(views, len(anchors), planar.colour_clip)
    for _ in range(planar.gauss_newton_steps):
        colours = _gauss_newton(views, colours, planar)
    features = anchors.features.clone()
    features[:, :COLOUR_CHANNELS] = torch.from_numpy(colours)
    return anchors.with_features(features)


def _local_means(views: Sequence[LinearView], n: int, clip: float) -> Float32Array:
    """Weighted mean of the target logits over the pixels each anchor touches."""
    total, weight = np.zeros((n, 3), np.float32), np.full((n, 1), 1e-6, np.float32)
    for view in views:
        logit = _logit(view.target, clip)
        total += view.weights.transposed_times(view.gather.transposed_times(logit))
        weight += view.weights.transposed_times(view.gather.transposed_times(np.ones_like(logit[:, :1])))
    return total / weight


def _gauss_newton(views: Sequence[LinearView], colours: Float32Array, planar: PlanarConfig) -> Float32Array:
    """One step: linearise the sigmoid, then conjugate gradients on the normal equations."""
    limit = np.float32(_logit(np.array([1.0], np.float32), planar.colour_clip)[0])
    slopes = []
    gradient = np.zeros_like(colours)
    for view in views:
        rgb = _sigmoid(view.weights.times(colours))
        slope = np.maximum(rgb * (1 - rgb), np.float32(1e-3))
        residual = view.target - view.gather.times(rgb)
        gradient += view.weights.transposed_times(slope * view.gather.transposed_times(residual))
        slopes.append(slope)
    # A little damping keeps anchors that no pixel determines where they are.
    damping = np.float32(1e-4)

    def normal(x: Float32Array) -> Float32Array:
        out = damping * x
        for view, slope in zip(views, slopes, strict=True):
            seen = view.gather.times(slope * view.weights.times(x))
            out += view.weights.transposed_times(slope * view.gather.transposed_times(seen))
        return out

    step = _conjugate_gradients(normal, gradient, planar.cg_steps)
    return np.asarray(np.clip(colours + step, -2 * limit, 2 * limit), np.float32)


def _conjugate_gradients(normal: Callable[[Float32Array], Float32Array], b: Float32Array, steps: int) -> Float32Array:
    """Solve normal(x) = b for three colour channels at once, each with its own step lengths."""
    x, r = np.zeros_like(b), b.copy()
    p, energy = r.copy(), (r * r).sum(0)
    for _ in range(steps):
        q = normal(p)
        length = energy / np.maximum((p * q).sum(0), 1e-30)
        x += length * p
        r -= length * q
        new_energy = (r * r).sum(0)
        p = r + (new_energy / np.maximum(energy, 1e-30)) * p
        energy = new_energy
    return x


def _sigmoid(logit: Float32Array) -> Float32Array:
    return np.asarray(1 / (1 + np.exp(-logit)), np.float32)


def _logit(colour: Float32Array, clip: float) -> Float32Array:
    clipped = np.clip(colour, clip, 1 - clip)
    return np.asarray(np.log(clipped / (1 - clipped)), np.float32)
