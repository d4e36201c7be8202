"""The closed-form fit: with frozen geometry, colour is a sparse linear map of what the anchors carry (METHOD.md 1.2).

With the analytic decoders a pixel's colour is sum_s T_s alpha_s sigmoid(sum_j w_sj c_j), c_j being the colour logits
of anchor j. Gauss-Newton on the logits; each step is a sparse least-squares problem, solved by a few conjugate-gradient
steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch

from orca.anchors import GaussianAnchors
from orca.config import PlanarConfig, RenderConfig
from orca.conventions import Float32Array
from orca.field.decoders import COLOUR_CHANNELS, Decoders
from orca.render.renderer import Renderer
from orca.stages.linear import LinearView, linear_view
from orca.stages.observations import Observation

__all__ = ["solve_colours"]


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
        total += view.weights.transposed_times(view.scatter(logit))
        weight += view.weights.transposed_times(view.scatter(np.ones_like(logit[:, :1])))
    return total / weight


def _gauss_newton(views: Sequence[LinearView], colours: Float32Array, planar: PlanarConfig) -> Float32Array:
    """One step: linearise the sigmoid, then conjugate gradients on the normal equations."""
    limit = np.float32(_logit(np.array([1.0], np.float32), planar.colour_clip)[0])
    slopes = []
    gradient = np.zeros_like(colours)
    for view in views:
        rgb = _sigmoid(view.weights.times(colours))
        slope = np.maximum(rgb * (1 - rgb), np.float32(1e-3))
        residual = view.target - view.gather(rgb)
        gradient += view.weights.transposed_times(slope * view.scatter(residual))
        slopes.append(slope)
    # A little damping keeps anchors that no pixel determines where they are.
    damping = np.float32(1e-4)

    def normal(x: Float32Array) -> Float32Array:
        out = damping * x
        for view, slope in zip(views, slopes, strict=True):
            seen = view.gather(slope * view.weights.times(x))
            out += view.weights.transposed_times(slope * view.scatter(seen))
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
