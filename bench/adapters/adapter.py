"""One protocol for every way in which a method's frames come in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from bench.datasets.case import SceneCase
from orca.conventions import Float32Array, UInt8Array

__all__ = ["Adapter", "MethodOutput", "RunOptions", "unheard"]


def unheard(phase: str, done: int, total: int) -> None:
    """Progress that nobody listens to."""


@dataclass(frozen=True)
class RunOptions:
    """What the user chose for a run, as far as an adapter needs it.

    Attributes:
        preset: name of the ORCA preset ("draft", "paper", ...).
        seed: the one random seed.
        device: "cpu" or "cuda".
        data_root: folder with `vistadream/rgb/*.mp4` and so on, or None.
        weights_dir: folder with downloaded weights, or None.
        work_dir: where an adapter may leave files of its own for this (method, scene), or None for nowhere.
        progress: called as progress(phase, done, total) while working.
    """

    preset: str = "draft"
    seed: int = 0
    device: str = "cpu"
    data_root: Path | None = None
    weights_dir: Path | None = None
    work_dir: Path | None = None
    progress: Callable[[str, int, int], None] = unheard


@dataclass(frozen=True, eq=False)
class MethodOutput:
    """The frames of one method on one scene.

    Attributes:
        frames: renders at ``case.eval_trajectory``, [n, H, W, 3] uint8.
        coverage: accumulated alpha of the frames in [0, 1], [n, H, W] float32; None if the method cannot tell.
        input_view: render at ``case.camera``, [H, W, 3] uint8; None if the method has none.
        true_views: renders at the cameras of ``case.true_views``, in order; None if the method cannot render there.
        true_view_coverage: accumulated alpha of those renders, or None.
        true_view_depth: z-depth of those renders in the units of the case, [H, W] float32, not positive where there is
            none; None if the method has no geometry there.
        frame_depth: the same for ``frames``, [n, H, W] float32 (NaN and infinite also mean none), or None. Stored as
            float16, which moves a point by less than 1/2000 of its parallax.
        timing: seconds per phase ("depth", "fit", "repair", "render", ...); "render_ms_per_frame" where known.
        model: size and make of the model: "anchors", "bytes", "preset", lifting, placement scale and spread, ...
        notes: what a reader of the table must know ("decoded from H.264 crf 23").
        coded: the pictures came out of an H.264 video, so codec matching leaves them as they are.
    """

    frames: UInt8Array
    coverage: Float32Array | None = None
    input_view: UInt8Array | None = None
    true_views: tuple[UInt8Array, ...] | None = None
    true_view_coverage: tuple[Float32Array, ...] | None = None
    true_view_depth: tuple[Float32Array, ...] | None = None
    frame_depth: Float32Array | None = None
    timing: dict[str, float] = field(default_factory=dict)
    model: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    coded: bool = False


class Adapter(Protocol):
    """A method: scene case in, frames out."""

    name: str

    def version(self, options: RunOptions) -> str:
        """A string that changes when the method's output would (code version, resolved preset)."""
        ...

    def run(self, case: SceneCase, options: RunOptions) -> MethodOutput:
        """Produce the frames. Raises an `OrcaError` for an expected failure; anything else is recorded as a crash."""
        ...
