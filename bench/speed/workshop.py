"""The scenes that are timed: an embedded photograph taken through the real stages, kept as files for other processes.

No data are needed. The depth is the heuristic's, with a nearer square set into it, so that a moving camera uncovers
something for stage 3 to repair.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from bench.datasets.case import SceneCase
from bench.datasets.photos import Photos
from bench.speed.case import BASE_WIDTH, Mode
from orca.camera import Camera
from orca.config import ReconstructConfig, get_preset
from orca.conventions import Float32Array, to_float
from orca.pipeline import Reconstruction, reconstruct
from orca.priors.depth import DepthEstimate
from orca.scene import Scene

__all__ = ["PHOTO", "Inputs", "Workshop", "config_for"]

PHOTO = "astronaut"
_FOREGROUND = 0.7  # depth of the square over what was there


@dataclass(frozen=True, eq=False)
class Inputs:
    """What a reconstruction starts from.

    Attributes:
        image: [W, W, 3] float32.
        camera: the input camera.
        depth: z-depth in scene radii.
        views: cameras of the default path.
    """

    image: Float32Array
    camera: Camera
    depth: DepthEstimate
    views: tuple[Camera, ...]

    def fit(self, config: ReconstructConfig) -> Reconstruction:
        """Stages 1 and 2: canvas, placement, planar fit, deformation, fit again."""
        config = replace(config, repair=replace(config.repair, enabled=False))
        return reconstruct(self.image, self.camera, self.depth, self.views, config)


class Workshop:
    """Makes inputs and fitted scenes, each scene once.

    Args:
        folder: where scenes are kept, for this process and those that measure memory.
        base_width: side of the image that scenes are fitted to; frames of other sizes show the same scene.
    """

    def __init__(self, folder: Path, base_width: int = BASE_WIDTH) -> None:
        self.folder, self.base_width = Path(folder), base_width
        self._case: SceneCase | None = None
        self._inputs: dict[int, Inputs] = {}
        self._scenes: dict[tuple[int, Mode], Scene] = {}

    def inputs(self, width: int) -> Inputs:
        """The photograph at a size of ``width`` x ``width``; beyond 512 it is interpolated."""
        if self._case is None:
            self._case = Photos().load(PHOTO)
        if width not in self._inputs:
            self._inputs[width] = _inputs(self._case, width)
        return self._inputs[width]

    def scene(self, anchors: int, mode: Mode) -> Scene:
        """A scene of about that many anchors after stage 2, fitted in the mode that it will be rendered in."""
        key = (anchors, mode)
        path = self.folder / f"{anchors}-{mode}.safetensors"
        if key not in self._scenes and path.is_file():
            self._scenes[key] = Scene.load(path)
        if key not in self._scenes:
            fitted = self.inputs(self.base_width).fit(config_for(anchors, mode, self.base_width)).scene
            fitted.save(path)
            self._scenes[key] = fitted
        return self._scenes[key]


def config_for(anchors: int, mode: Mode, width: int) -> ReconstructConfig:
    """The draft preset with that many anchors for an image of ``width`` x ``width``; per hit means the paper's."""
    draft = get_preset("draft")
    render = replace(draft.render, decode="layered")
    if mode == "per-hit":
        render = replace(draft.render, decode="per_hit", window=2)
    return replace(draft, render=render, planar=replace(draft.planar, anchors_per_pixel=anchors / width**2))


def _inputs(case: SceneCase, width: int) -> Inputs:
    size = (width, width)
    how = cv2.INTER_AREA if width <= case.image.shape[1] else cv2.INTER_CUBIC
    image = np.clip(cv2.resize(to_float(case.image), size, interpolation=how), 0, 1).astype(np.float32)
    depth = cv2.resize(case.depth, size, interpolation=cv2.INTER_LINEAR).astype(np.float32)
    near = slice(round(0.35 * width), round(0.6 * width))
    depth[near, near] = _FOREGROUND * depth[near, near].min()
    return Inputs(
        image,
        case.camera.resized(*size),
        DepthEstimate(depth, f"{case.depth_source}, with a nearer square", False),
        tuple(view.resized(*size) for view in case.trajectory.cameras()),
    )
