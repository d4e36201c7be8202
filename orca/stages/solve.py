"""The closed-form fit: with frozen geometry, colour is a sparse linear map of what the anchors carry (METHOD.md 1.2).

With the analytic decoders a pixel's colour is sum_s T_s alpha_s sigmoid(sum_j w_sj c_j), c_j being the colour logits
of anchor j. Gauss-Newton on the logits; each step is a sparse least-squares problem, solved by a few conjugate-gradient
steps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch

from orca.anchors import GaussianAnchors
from orca.config import PlanarConfig, RenderConfig
from orca.conventions import Float32Array
from orca.field.decoders import COLOUR_CHANNELS, Decoders
from orca.render.renderer import Renderer
from orca.stages.forward import Forward, forward
from orca.stages.linear import LinearView, linear_view
from orca.stages.normal import NormalEquations, conjugate_gradients
from orca.stages.observations import Observation

__all__ = ["Refined", "Solved", "refine", "solve", "solve_colours", "with_colours"]

_DAMPING = 1e-4  # keeps anchors that no pixel determines where they are


@dataclass(frozen=True, eq=False)
class Solved:
    """A closed-form fit.

    Attributes:
        anchors: anchors that carry the colours found.
        before, after: PSNR of the first observation in dB, with the colours it started from and with those found.
    """

    anchors: GaussianAnchors
    before: float
    after: float


class Refined(NamedTuple):
    """Colour logits [N, 3], and what the rays saw of those before and see of these, [R, 3] each."""

    colours: Float32Array
    before: Float32Array
    after: Float32Array


def solve(
    anchors: GaussianAnchors,
    decoders: Decoders,
    observed: Sequence[Observation],
    planar: PlanarConfig,
    render: RenderConfig,
) -> Solved:
    """Find the colour channels that reproduce the observations best, in the least-squares sense.

    Starts from what the anchors carry; a fresh set (all zero) starts from the local mean of the target logits.
    """
    view = linear_view(Renderer(anchors, decoders, render), *observed)
    colours = anchors.features[:, :COLOUR_CHANNELS].numpy().copy()
    found = refine(view, colours if colours.any() else None, planar, planar.gauss_newton_steps)
    first = slice(len(observed[0].rays))
    before, after = (_psnr(seen[first], view.target[first]) for seen in (found.before, found.after))
    return Solved(with_colours(anchors, found.colours), before, after)


def solve_colours(
    anchors: GaussianAnchors,
    decoders: Decoders,
    observed: Sequence[Observation],
    planar: PlanarConfig,
    render: RenderConfig,
) -> GaussianAnchors:
    """The anchors that `solve` finds."""
    return solve(anchors, decoders, observed, planar, render).anchors


def refine(view: LinearView, colours: Float32Array | None, planar: PlanarConfig, steps: int) -> Refined:
    """Gauss-Newton steps from the colour logits given, or from the local mean of the target's."""
    colours = _local_means(view, planar.colour_clip) if colours is None else colours
    now = forward(view, colours)
    before = now.seen
    for _ in range(steps):
        colours = _gauss_newton(view, colours, now, planar)
        now = forward(view, colours)
    return Refined(colours, before, now.seen)


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


def _gauss_newton(view: LinearView, colours: Float32Array, now: Forward, planar: PlanarConfig) -> Float32Array:
    """One step: linearise the sigmoid, then conjugate gradients on the normal equations."""
    limit = np.float32(_logit(np.array([1.0], np.float32), planar.colour_clip)[0])
    equations = NormalEquations(view, now.slope, _DAMPING)
    gradient = equations.at_anchors(now.missing)
    step = conjugate_gradients(equations.times, gradient, equations.diagonal(), planar.cg_steps)
    return np.asarray(np.clip(colours + step, -2 * limit, 2 * limit), np.float32)


def _logit(colour: Float32Array, clip: float) -> Float32Array:
    clipped = np.clip(colour, clip, 1 - clip)
    return np.asarray(np.log(clipped / (1 - clipped)), np.float32)


def _psnr(seen: Float32Array, target: Float32Array) -> float:
    """PSNR in dB of colours, clipped as they are shown."""
    error = float(np.square(np.clip(seen, 0, 1) - target, dtype=np.float64).mean())
    return -10 * math.log10(max(error, 1e-12))
