"""From neural anchors to plain splats that look the same.

A splat viewer blends one by one what ORCA decodes together, so each anchor's own colour gives another, coarser picture
(23 dB from the neural one on a typical scene). Colours, opacities and sizes are therefore fitted to the neural
renderings of the input view and of a few views of the path. Positions and orientations stay those of the anchors, but
where one splat cannot show what its anchor and the neighbours decode together, it is split.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from orca.camera import Camera
from orca.conventions import Float32Array
from orca.errors import BadInput
from orca.progress import Progress
from orca.splats.agreement import agreement
from orca.splats.gradient import Footprints, footprints, loss_and_gradient
from orca.splats.model import Splats
from orca.splats.split import blame, split, worst
from orca.splats.view import view_splats

if TYPE_CHECKING:
    from orca.render.renderer import Rendering
    from orca.scene import Scene

__all__ = ["BakeConfig", "anchor_splats", "bake", "fitted_frames", "splat_opacities"]

_MOMENTUM, _INERTIA = 0.9, 0.98  # Adam's betas; the second forgets within the steps that there are


@dataclass(frozen=True)
class BakeConfig:
    """How splats are fitted.

    Attributes:
        steps: Adam steps, each on the input view and one more; 0 leaves every anchor's own colour and opacity.
        views: views of the path that are fitted beside the input view, evenly spaced.
        input_weight: how much the input view counts against one other view.
        zoom: the input view is also fitted at this many times its resolution, since browsers draw at any size;
            0 leaves that out (1 dB more at the input view's own resolution, 2 dB less at twice of it).
        min_growth, max_growth: smallest and largest size of a splat over that of its anchor ...
        min_sigma: ... but none is narrower than this many pixels in the input view, even if it has to be larger: some
            viewers leave out what is small (viser, if alpha times the determinant is under 0.25 px^4), at a cost in
            agreement for all others (1.2 dB with 0.5 px on a fine texture).
        start_opacity: opacities start at this or below; an opaque splat has no gradient.
        target_psnr: agreement with the neural render at the input view, in dB, under which splats are split ...
        rounds: ... and fitted again with half the steps, at least one, at most so often; sizes are limited in each fit
            by those that it began with.
        rate_colour, rate_opacity, rate_growth: learning rates.
    """

    steps: int = 120
    views: int = 6
    input_weight: float = 3.0
    zoom: float = 2.0
    min_growth: float = 0.25
    max_growth: float = 1.4
    min_sigma: float = 0.0
    start_opacity: float = 0.95
    target_psnr: float = 35.5
    rounds: int = 2
    rate_colour: float = 0.02
    rate_opacity: float = 0.1
    rate_growth: float = 0.03

    def __post_init__(self) -> None:
        if min(self.steps, self.views, self.rounds) < 0:
            given = f"{self.steps} steps on {self.views} views, {self.rounds} rounds"
            raise BadInput(given, "0 or more of each", "ask for more")
        if not np.isfinite(self.target_psnr):
            raise BadInput(f"a target of {self.target_psnr} dB", "a finite number of dB", "ask for 36, say")


def splat_opacities(scene: Scene) -> Float32Array:
    """Opacity in [0, 1] of each anchor alone at its centre, 1 - exp(-sigma sigmoid(omega)), [N].

    That is what the quadrature composes (METHOD.md 1). sigmoid(omega) itself, before the decoded density sigma, is not
    an opacity that a splat viewer could use: the scene would be see-through in it.
    """
    import torch

    with torch.inference_mode():
        sigma = scene.decoders(scene.anchors.features)[0]
        alpha = 1.0 - torch.exp(-sigma * torch.sigmoid(scene.anchors.opacity_logits))
    return np.asarray(alpha.cpu().numpy(), np.float32)


def anchor_splats(scene: Scene) -> Splats:
    """One splat an anchor, in order, with the colour and opacity of that anchor decoded alone.

    Raises:
        BadInput: anchors that are not finite.
    """
    anchors = scene.anchors
    quaternions = anchors.quaternions.detach().cpu().numpy()
    norms = np.linalg.norm(quaternions, axis=1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        unit = (quaternions / norms).astype(np.float32)
    splats = Splats(
        means=anchors.means.detach().cpu().numpy(),
        log_scales=np.float32(0.5) * anchors.log_variances.detach().cpu().numpy(),
        quaternions=unit,
        colours=np.asarray(scene.anchor_colors(), np.float32),
        opacities=splat_opacities(scene),
        stage=anchors.stage.cpu().numpy(),
    )
    bad = splats.broken()
    if bad:
        raise BadInput(
            f"a scene with {bad} of {len(splats)} anchors that are not finite",
            "finite anchors",
            "reconstruct the scene again",
        )
    return splats


def bake(scene: Scene, path: Sequence[Camera], config: BakeConfig, progress: Progress | None = None) -> Splats:
    """Splats that look like the scene from its input view and along ``path``.

    Args:
        scene: what to imitate.
        path: cameras from which it will be looked at; a few evenly spaced ones are fitted.
        config: how long, and how.
        progress: called as ("bake", done, total), then ("bake, split K", done, total) for each round of splitting.
    """
    splats = anchor_splats(scene)
    if config.steps == 0:
        return splats
    first = scene.camera
    cameras = [first, *(path[i] for i in fitted_frames(len(path), config))]
    if config.zoom:
        cameras.append(first.resized(round(first.width * config.zoom), round(first.height * config.zoom)))
    renderer = scene.renderer()
    background = scene.render_config.background
    targets = [_over_black(renderer.render(camera), background) for camera in cameras]
    for left in range(config.rounds, -1, -1):
        views = [_View(footprints(splats, c, config.max_growth), t) for c, t in zip(cameras, targets, strict=True)]
        steps = config.steps if left == config.rounds else (config.steps + 1) // 2
        splats = _fit(splats, views, replace(config, steps=steps), _named(progress, config.rounds - left))
        surplus = config.target_psnr - agreement(scene, splats, (first,))[0]
        if left == 0 or surplus <= 0:
            break
        picture = view_splats(splats, first).rgb.reshape(-1, 3)
        splats = split(splats, worst(blame(footprints(splats, first, 1.0), picture, targets[0], splats), surplus))
    return splats


def _named(progress: Progress | None, round_: int) -> Callable[[int, int], None]:
    phase = f"bake, split {round_}" if round_ else "bake"
    return lambda done, total: progress(phase, done, total) if progress is not None else None


@dataclass(frozen=True, eq=False)
class _View:
    """Where splats may be seen in one view, and what should be seen: rgb over black, and alpha, [P, 4]."""

    seen: Footprints
    target: Float32Array

    def gradient(self, values: Float32Array, opacities: Float32Array) -> Float32Array:
        """By colour, opacity and log size, [N, 5]; a large picture does not count more than a small one."""
        colours, growth = np.ascontiguousarray(values[:, :3]), np.ascontiguousarray(values[:, 4])
        gradient = loss_and_gradient(self.seen, self.target, colours, opacities, growth)[1]
        return gradient / np.float32(len(self.target))


def _over_black(rendering: Rendering, background: float) -> Float32Array:
    rgb = rendering.rgb - (1 - rendering.alpha[..., None]) * np.float32(background)
    return np.ascontiguousarray(np.concatenate([rgb, rendering.alpha[..., None]], axis=2).reshape(-1, 4), np.float32)


def fitted_frames(length: int, config: BakeConfig) -> list[int]:
    """Which frames of a path of that length `bake` fits."""
    between = np.linspace(0, length, config.views + 2)[1:-1].astype(int)
    return sorted(set(between.tolist())) if length else []


def _fit(splats: Splats, views: Sequence[_View], config: BakeConfig, progress: Callable[[int, int], None]) -> Splats:
    """Adam on (colour, opacity logit, log size); the rates fade to zero over the second half."""
    start = np.clip(splats.opacities, 0.01, config.start_opacity)
    logits, growth = np.log(start / (1 - start)), np.zeros(len(splats))
    values = np.column_stack([splats.colours, logits, growth]).astype(np.float32)
    smallest, largest = _growth_limits(views[0].seen, config)
    low, high = (np.zeros_like(values) for _ in range(2))
    low[:, 3:], high[:, :3], high[:, 3:] = -np.inf, 1, np.inf
    low[:, 4], high[:, 4] = smallest, largest
    rates = np.array([config.rate_colour] * 3 + [config.rate_opacity, config.rate_growth], np.float32)
    first, second = np.zeros_like(values), np.zeros_like(values)
    for step in range(config.steps):
        opacities = _sigmoid(values[:, 3])
        gradient = np.float32(config.input_weight) * views[0].gradient(values, opacities)
        if len(views) > 1:
            gradient += views[1 + step % (len(views) - 1)].gradient(values, opacities)
        gradient[:, 3] *= opacities * (1 - opacities)
        first += np.float32(1 - _MOMENTUM) * (gradient - first)
        second += np.float32(1 - _INERTIA) * (gradient * gradient - second)
        size = np.sqrt(second / np.float32(1 - _INERTIA ** (step + 1))) + np.float32(1e-15)
        fade = np.float32(min(1.0, 2 * (1 - step / config.steps)))
        values -= fade * rates * (first / np.float32(1 - _MOMENTUM ** (step + 1))) / size
        np.clip(values, low, high, out=values)
        progress(step + 1, config.steps)
    colours = np.ascontiguousarray(values[:, :3])
    return replace(splats.grown(values[:, 4]), colours=colours, opacities=_sigmoid(values[:, 3]))


def _growth_limits(seen: Footprints, config: BakeConfig) -> tuple[Float32Array, Float32Array]:
    """Smallest and largest log size of each splat, [N] each."""
    xx, xy, yy = seen.covariance.astype(np.float64).T
    narrow = (xx + yy) / 2 - np.hypot((xx - yy) / 2, xy)  # the smaller eigenvalue
    needed = np.log(max(config.min_sigma, 1e-6)) - 0.5 * np.log(np.maximum(narrow, 1e-12))
    largest = np.log(config.max_growth)
    smallest = np.clip(needed, np.log(config.min_growth), largest)
    return smallest.astype(np.float32), np.full(len(narrow), largest, np.float32)


def _sigmoid(logits: Float32Array) -> Float32Array:
    return np.asarray(1 / (1 + np.exp(-logits)), np.float32)
