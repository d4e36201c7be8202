"""Is what a method returned what it promised? Checked before anything is scored."""

from __future__ import annotations

import numpy as np

from bench.adapters.adapter import MethodOutput
from bench.datasets.case import SceneCase
from orca.conventions import Float32Array, UInt8Array
from orca.errors import OrcaError

__all__ = ["BadOutput", "check_output"]


class BadOutput(OrcaError):
    """A method returned something that cannot be scored."""

    kind = "bad_output"


def check_output(case: SceneCase, output: MethodOutput) -> None:
    """Compare counts, shapes, types and ranges with the case.

    Frames may have another size than the case (a published video is what it is; metrics resize it), the same for all.

    Raises:
        BadOutput: wrong number or shape of frames, wrong type, coverage outside [0, 1] or not finite.
    """
    _check_image("frames", output.frames, (len(case.eval_indices), None, None, 3))
    if output.coverage is not None:
        _check_coverage("coverage", output.coverage, output.frames.shape[:3])
    if output.frame_depth is not None:
        _check_depth("frame_depth", output.frame_depth, output.frames.shape[:3])
    if output.input_view is not None:
        _check_image("input_view", output.input_view, (None, None, 3))
    per_view = ("true_views", "true_view_coverage", "true_view_depth")
    for name, views in ((name, getattr(output, name)) for name in per_view):
        if views is not None and len(views) != len(case.true_views):
            raise _wrong(name, f"{len(views)} of them", f"{len(case.true_views)}, one for each true view")
    for view in output.true_views or ():
        _check_image("true_views", view, (None, None, 3))
    for view, alpha in zip(output.true_views or (), output.true_view_coverage or ()):
        _check_coverage("true_view_coverage", alpha, view.shape[:2])
    for view, depth in zip(output.true_views or (), output.true_view_depth or ()):
        _check_depth("true_view_depth", depth, view.shape[:2])


def _check_image(name: str, image: UInt8Array, shape: tuple[int | None, ...]) -> None:
    allowed = "uint8 [" + ", ".join("any" if side is None else str(side) for side in shape) + "]"
    if not isinstance(image, np.ndarray) or image.dtype != np.uint8 or image.ndim != len(shape) or not image.size:
        raise _wrong(name, _described(image), allowed)
    if any(side is not None and side != found for side, found in zip(shape, image.shape, strict=True)):
        raise _wrong(name, _described(image), allowed)


def _check_coverage(name: str, coverage: Float32Array, shape: tuple[int, ...]) -> None:
    if not isinstance(coverage, np.ndarray) or coverage.dtype != np.float32 or coverage.shape != shape:
        raise _wrong(name, _described(coverage), f"float32 {list(shape)}")
    low, high = float(coverage.min()), float(coverage.max())
    if not (low >= -1e-3 and high <= 1 + 1e-3):  # NaN fails too
        raise _wrong(name, f"values from {low:g} to {high:g}", "finite values in [0, 1]")


def _check_depth(name: str, depth: Float32Array, shape: tuple[int, ...]) -> None:
    if not isinstance(depth, np.ndarray) or depth.dtype != np.float32 or depth.shape != shape:
        raise _wrong(name, _described(depth), f"float32 {list(shape)}")


def _described(array: object) -> str:
    return f"{array.dtype} {list(array.shape)}" if isinstance(array, np.ndarray) else type(array).__name__


def _wrong(name: str, given: str, allowed: str) -> BadOutput:
    return BadOutput(f"the method returned {name}: {given}", allowed, "mend the method's adapter")
