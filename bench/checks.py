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
    """Compare shapes, types and ranges with the case.

    Raises:
        BadOutput: wrong number or size of frames, wrong type, coverage outside [0, 1] or not finite.
    """
    path = case.trajectory
    _check_image("frames", output.frames, (len(case.eval_indices), path.height, path.width, 3))
    if output.coverage is not None:
        _check_coverage("coverage", output.coverage, output.frames.shape[:3])
    if output.input_view is not None:
        _check_image("input_view", output.input_view, (case.camera.height, case.camera.width, 3))
    for name, views in (("true_views", output.true_views), ("true_view_coverage", output.true_view_coverage)):
        if views is not None and len(views) != len(case.true_views):
            raise _wrong(name, f"{len(views)} of them", f"{len(case.true_views)}, one for each true view")
    for view, truth in zip(output.true_views or (), case.true_views):
        _check_image("true_views", view, (truth.camera.height, truth.camera.width, 3))
    for alpha, truth in zip(output.true_view_coverage or (), case.true_views):
        _check_coverage("true_view_coverage", alpha, (truth.camera.height, truth.camera.width))


def _check_image(name: str, image: UInt8Array, shape: tuple[int, ...]) -> None:
    if not isinstance(image, np.ndarray) or image.dtype != np.uint8 or image.shape != shape:
        raise _wrong(name, _described(image), f"uint8 {list(shape)}")


def _check_coverage(name: str, coverage: Float32Array, shape: tuple[int, ...]) -> None:
    if not isinstance(coverage, np.ndarray) or coverage.dtype != np.float32 or coverage.shape != shape:
        raise _wrong(name, _described(coverage), f"float32 {list(shape)}")
    low, high = float(coverage.min()), float(coverage.max())
    if not (low >= -1e-3 and high <= 1 + 1e-3):  # NaN fails too
        raise _wrong(name, f"values from {low:g} to {high:g}", "finite values in [0, 1]")


def _described(array: object) -> str:
    return f"{array.dtype} {list(array.shape)}" if isinstance(array, np.ndarray) else type(array).__name__


def _wrong(name: str, given: str, allowed: str) -> BadOutput:
    return BadOutput(f"the method returned {name}: {given}", allowed, "mend the method's adapter")
