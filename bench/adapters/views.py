"""Render every view that a case asks of a method: the evaluated path, the input view, the true views."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from bench.adapters.adapter import MethodOutput, RunOptions
from bench.datasets.case import SceneCase
from orca.camera import Camera
from orca.conventions import Float32Array, to_uint8

__all__ = ["RenderedView", "render_case"]

_COVERED = 0.5  # as the metric of holes has it


class RenderedView(Protocol):
    """Colour [H, W, 3], accumulated alpha [H, W] and z-depth [H, W] of one view."""

    @property
    def rgb(self) -> Float32Array: ...
    @property
    def alpha(self) -> Float32Array: ...
    @property
    def depth(self) -> Float32Array: ...


def render_case(
    render: Callable[[Camera], RenderedView],
    case: SceneCase,
    options: RunOptions,
    model: dict[str, Any],
    notes: Sequence[str] = (),
    seconds: dict[str, float] | None = None,
    unit: float = 1.0,
) -> MethodOutput:
    """The output of a method that can render anywhere.

    Args:
        render: renders one view.
        case: says which views.
        options: told of the progress.
        model: size and make of the model.
        notes: what a reader of the table must know.
        seconds: of the phases before rendering.
        unit: the method's unit of length in units of the case; depths are divided by it.
    """
    truth = tuple(view.camera for view in case.true_views)
    cameras = (*case.eval_trajectory.cameras(), case.camera, *truth)
    started = time.perf_counter()
    images, alphas, depths = [], [], []
    for done, camera in enumerate(cameras, start=1):
        view = render(camera)
        images.append(to_uint8(view.rgb))
        alphas.append(view.alpha)
        depths.append(view.depth / np.float32(unit))
        options.progress("render", done, len(cameras))
    spent = time.perf_counter() - started
    n = len(case.eval_indices)
    return MethodOutput(
        frames=np.stack(images[:n]),
        coverage=np.stack(alphas[:n]),
        input_view=images[n],
        true_views=tuple(images[n + 1 :]),
        true_view_coverage=tuple(alphas[n + 1 :]),
        true_view_depth=tuple(depths[n + 1 :]),
        frame_depth=np.stack(depths[:n]),
        timing={**(seconds or {}), "render": spent, "render_ms_per_frame": 1e3 * spent / len(cameras)},
        model=model,
        notes=(*notes, *_about_holes([*alphas[:n], *alphas[n + 1 :]])),
    )


def _about_holes(alphas: Sequence[Float32Array]) -> tuple[str, ...]:
    """A note about what the scene does not cover, where that is more than 1 % of the pixels of all views."""
    share = float(np.mean([np.mean(~(alpha >= _COVERED)) for alpha in alphas]))
    note = f"{share:.1%} of the pixels of all novel views are holes: nothing of the scene is there"
    return (note,) if share > 0.01 else ()
