"""The warp baselines: the input, moved by its reference depth; what a user would otherwise do by hand."""

from __future__ import annotations

import time
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.adapters.adapter import MethodOutput, RunOptions
from bench.datasets.case import SceneCase
from bench.warping import forward_splat
from orca.camera import Camera
from orca.conventions import Float32Array, UInt8Array

__all__ = ["WARP", "WARP_TELEA", "Warp"]

TELEA_RADIUS = 3


@dataclass(frozen=True)
class Warp:
    """Forward-warped RGB-D: nearest point splats at every camera, holes black or inpainted frame by frame.

    Attributes:
        name: method name.
        fill_holes: inpaint each frame's holes (Telea 2004, radius 3 px).
    """

    name: str
    fill_holes: bool

    def version(self, options: RunOptions) -> str:
        """What the frames depend on; no preset and no seed among it."""
        splat = "warp 1: nearest splat, z-buffer"
        return (
            f"{splat}; cv2.inpaint Telea radius {TELEA_RADIUS}, opencv {cv2.__version__}" if self.fill_holes else splat
        )

    def run(self, case: SceneCase, options: RunOptions) -> MethodOutput:
        """Warp the input onto the evaluated cameras and the true views' cameras. Raises `BadInput` for a bad case."""
        clock = {"render": 0.0}
        views, total = [], len(case.eval_indices) + len(case.true_views)
        cameras = [*case.eval_trajectory.cameras(), *(view.camera for view in case.true_views)]
        for done, camera in enumerate(cameras, start=1):
            views.append(self._view(case, camera, clock))
            options.progress("render", done, total)
        novel, true = views[: len(case.eval_indices)], views[len(case.eval_indices) :]
        clock["render_ms_per_frame"] = 1e3 * sum(clock.values()) / total
        return MethodOutput(
            frames=np.stack([rgb for rgb, _ in novel]),
            coverage=np.stack([alpha for _, alpha in novel]),
            input_view=case.image,
            true_views=tuple(rgb for rgb, _ in true),
            true_view_coverage=tuple(alpha for _, alpha in true),
            timing=clock,
            model={
                "is_warp_reference": True,
                "points": int(case.depth.size),
                "bytes": int(case.image.nbytes + case.depth.nbytes),
            },
            notes=self._notes(case),
        )

    def _view(self, case: SceneCase, camera: Camera, clock: dict[str, float]) -> tuple[UInt8Array, Float32Array]:
        """Colours and coverage at one camera; adds the seconds to the clock."""
        started = time.perf_counter()
        splat = forward_splat(case.image, case.depth, case.camera, camera)
        splatted = time.perf_counter()
        clock["render"] += splatted - started
        if not self.fill_holes:
            return splat.rgb, splat.hit.astype(np.float32)
        filled = _inpaint(splat.rgb, splat.hit)
        clock["inpaint"] = clock.get("inpaint", 0.0) + time.perf_counter() - splatted
        return filled, np.ones(splat.hit.shape, np.float32)

    def _notes(self, case: SceneCase) -> tuple[str, ...]:
        depth = f"warped with the reference depth ({case.depth_source})"
        view = "the input view is the input itself"
        if not self.fill_holes:
            return depth, view, "holes, cracks included, are black"
        return depth, view, f"holes inpainted by Telea, radius {TELEA_RADIUS} px, each frame alone: coverage is 1"


def _inpaint(rgb: UInt8Array, hit: NDArray[np.bool_]) -> UInt8Array:
    if hit.all() or not hit.any():  # nothing to fill, or nothing to fill from
        return rgb
    return np.asarray(cv2.inpaint(rgb, (~hit).astype(np.uint8), TELEA_RADIUS, cv2.INPAINT_TELEA), np.uint8)


WARP = Warp("warp", fill_holes=False)
WARP_TELEA = Warp("warp-telea", fill_holes=True)
