"""The closed-form fit: with frozen geometry, colour is a sparse linear map of what the anchors carry (METHOD.md 1.2).

With the analytic decoders a pixel's colour is sum_s T_s alpha_s sigmoid(sum_j w_sj c_j), c_j being the colour logits
of anchor j. Gauss-Newton on the logits; each step is a sparse least-squares problem, solved by a few conjugate-gradient
steps.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from orca.anchors import GaussianAnchors
from orca.config import PlanarConfig, RenderConfig
from orca.conventions import Float32Array
from orca.field.decoders import COLOUR_CHANNELS, Decoders
from orca.render.renderer import Renderer
from orca.stages.linear import LinearView, linear_view
from orca.stages.normal import NormalEquations, conjugate_gradients
from orca.stages.observations import Observation

__all__ = ["predicted", "refine", "solve_colours", "with_colours"]

_DAMPING = 1e-4  # keeps anchors that no pixel determines where they are


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
    view = linear_view(Renderer(anchors, decoders, render), *observed)
    colours = anchors.features[:, :COLOUR_CHANNELS].numpy().copy()
    return with_colours(anchors, refine(view, colours if colours.any() else None, planar, planar.gauss_newton_steps))


def refine(view: LinearView, colours: Float32Array | None, planar: PlanarConfig, steps: int) -> Float32Array:
    """Colour logits [N, 3] after some Gauss-Newton steps from those given, or from the local mean of the target's."""
    colours = _local_means(view, planar.colour_clip) if colours is None else colours
    for _ in range(steps):
        colours = _gauss_newton(view, colours, planar)
    return colours


def predicted(view: LinearView, colours: Float32Array) -> Float32Array:
    """What the rays see of anchors with these colour logits, [R, 3]."""
    return view.gather(_sigmoid(view.weights.times(colours)))


def with_colours(anchors: GaussianAnchors, colours: Float32Array) -> GaussianAnchors:
    """Anchors that carry these colour logits [N, 3]."""
    features = anchors.features.clone()
    features[:, :COLOUR_CHANNELS] = torch.from_numpy(colours)
    return anchors.with_features(features)


def _local_means(view: LinearView, clip: float) -> Float32Array:
    """Weighted mean of the target logits over the pixels each anchor touches."""
    logit = _logit(view.target, clip)
    total = view.weights.transposed_times(view.scatter(logit))
    weight = view.weights.transposed_times(view.scatter(np.ones_like(logit)))
    return np.asarray(total / np.maximum(weight, 1e-6), np.float32)


def _gauss_newton(view: LinearView, colours: Float32Array, planar: PlanarConfig) -> Float32Array:
    """One step: linearise the sigmoid, then conjugate gradients on the normal equations."""
    limit = np.float32(_logit(np.array([1.0], np.float32), planar.colour_clip)[0])
    rgb = _sigmoid(view.weights.times(colours))
    slope = np.maximum(rgb * (1 - rgb), np.float32(1e-3))
    equations = NormalEquations(view, slope, _DAMPING)
    gradient = view.weights.transposed_times(slope * view.scatter(view.target - view.gather(rgb)))
    step = conjugate_gradients(equations.times, gradient, equations.diagonal(), planar.cg_steps)
    return np.asarray(np.clip(colours + step, -2 * limit, 2 * limit), np.float32)


def _sigmoid(logit: Float32Array) -> Float32Array:
    return np.asarray(1 / (1 + np.exp(-logit)), np.float32)


def _logit(colour: Float32Array, clip: float) -> Float32Array:
    clipped = np.clip(colour, clip, 1 - clip)
    return np.asarray(np.log(clipped / (1 - clipped)), np.float32)
