"""The warp baselines: the input, moved by its reference depth; what a user would otherwise do by hand."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.adapters.adapter import MethodOutput, RunOptions
from bench.datasets.case import SceneCase
from bench.warping import forward_splat
from orca.camera import Camera
from orca.conventions import Float32Array, UInt8Array

__all__ = ["WARP", "WARP_NEAREST", "WARP_TELEA", "Warp"]

TELEA_RADIUS = 3
_AT_ONCE = 8  # views between two reports of progress

_View = tuple[UInt8Array, Float32Array, Float32Array]  # rgb, coverage, depth


@dataclass(frozen=True)
class Warp:
    """Forward-warped RGB-D: nearest point splats at every camera, holes black or inpainted frame by frame.

    Attributes:
        name: method name.
        fill: what becomes of holes, frame by frame: "none" leaves them black, "telea" inpaints them (Telea 2004,
            radius 3 px), "nearest" copies the nearest pixel that is no hole.
    """

    name: str
    fill: Literal["none", "telea", "nearest"]

    def version(self, options: RunOptions) -> str:
        """What the frames depend on; no preset and no seed among it."""
        splat = "warp 1: nearest splat, z-buffer"
        telea = f"; cv2.inpaint Telea radius {TELEA_RADIUS}, opencv {cv2.__version__}"
        return splat + {"none": "", "telea": telea, "nearest": "; nearest fill"}[self.fill]

    def run(self, case: SceneCase, options: RunOptions) -> MethodOutput:
        """Warp the input onto the evaluated cameras and the true views' cameras. Raises `BadInput` for a bad case."""
        cameras = [*case.eval_trajectory.cameras(), *(view.camera for view in case.true_views)]
        clock = {"render": 0.0}
        views: list[_View] = []
        for first in range(0, len(cameras), _AT_ONCE):
            views += self._views(case, cameras[first : first + _AT_ONCE], clock)
            options.progress("render", len(views), len(cameras))
        novel, true = views[: len(case.eval_indices)], views[len(case.eval_indices) :]
        clock["render_ms_per_frame"] = 1e3 * sum(clock.values()) / len(cameras)
        return MethodOutput(
            frames=np.stack([rgb for rgb, _, _ in novel]),
            coverage=np.stack([alpha for _, alpha, _ in novel]),
            input_view=case.image,
            true_views=tuple(rgb for rgb, _, _ in true),
            true_view_coverage=tuple(alpha for _, alpha, _ in true),
            frame_depth=np.stack([depth for _, _, depth in novel]),
            timing=clock,
            model={
                "is_warp_reference": True,
                "points": int(case.depth.size),
                "bytes": int(case.image.nbytes + case.depth.nbytes),
            },
            notes=self._notes(case),
        )

    def _views(self, case: SceneCase, cameras: Sequence[Camera], clock: dict[str, float]) -> list[_View]:
        """Colours, coverage and depth at some cameras; adds the seconds to the clock."""
        from orca.threads import map_on_cores  # loads torch

        started = time.perf_counter()
        splats = map_on_cores(lambda camera: forward_splat(case.image, case.depth, case.camera, camera), cameras)
        splatted = time.perf_counter()
        clock["render"] += splatted - started
        if self.fill == "none":
            return [(splat.rgb, splat.hit.astype(np.float32), splat.depth) for splat in splats]
        fill = _inpaint if self.fill == "telea" else _nearest
        filled = map_on_cores(lambda splat: fill(splat.rgb, splat.hit), splats)
        clock["inpaint"] = clock.get("inpaint", 0.0) + time.perf_counter() - splatted
        return [
            # A view without a single point has nothing to be filled from: it stays a hole.
            (rgb, np.full(rgb.shape[:2], float(splat.hit.any()), np.float32), splat.depth)
            for rgb, splat in zip(filled, splats, strict=True)
        ]

    def _notes(self, case: SceneCase) -> tuple[str, ...]:
        depth = f"warped with the reference depth ({case.depth_source})"
        view = "the input view is the input itself"
        if self.fill == "none":
            return depth, view, "holes, cracks included, are black"
        how = (
            f"inpainted by Telea, radius {TELEA_RADIUS} px" if self.fill == "telea" else "filled with the nearest pixel"
        )
        return depth, view, f"holes {how}, each frame alone: coverage is 1, or 0 where a frame has no point"


def _inpaint(rgb: UInt8Array, hit: NDArray[np.bool_]) -> UInt8Array:
    if hit.all() or not hit.any():  # nothing to fill, or nothing to fill from
        return rgb
    return np.asarray(cv2.inpaint(rgb, (~hit).astype(np.uint8), TELEA_RADIUS, cv2.INPAINT_TELEA), np.uint8)


def _nearest(rgb: UInt8Array, hit: NDArray[np.bool_]) -> UInt8Array:
    if not hit.any():
        return rgb
    _, labels = cv2.distanceTransformWithLabels(
        (~hit).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    table = np.zeros((int(labels.max()) + 1, 3), np.uint8)
    table[labels[hit]] = rgb[hit]
    return np.asarray(table[labels])


WARP = Warp("warp", "none")
WARP_TELEA = Warp("warp-telea", "telea")
WARP_NEAREST = Warp("warp-nearest", "nearest")
