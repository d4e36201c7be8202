"""ORCA scene files as a method: what `orca reconstruct` or an earlier run saved, rendered along the case's cameras."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bench.adapters.adapter import MethodOutput, RunOptions
from bench.adapters.external import ExternalSpec
from bench.adapters.sources import fingerprint, one_of
from bench.adapters.views import render_case
from bench.datasets.case import SceneCase
from orca.camera import Camera
from orca.errors import BadInput

if TYPE_CHECKING:
    from orca.render.renderer import Rendering

__all__ = ["FILE_NAMES", "OrcaScenes", "open_orca_scene"]

FILE_NAMES = ("{scene}.safetensors", "{scene}/scene.safetensors")
MAX_BYTES = 8 * 2**30
_SAME_UNIT = 0.02  # a scene made in this unit renders its depth within this share of it


def open_orca_scene(spec: ExternalSpec) -> OrcaScenes:
    """The factory of kind ``orca-scene``."""
    spec.no_options()
    return OrcaScenes(spec.name, spec.path)


@dataclass(frozen=True)
class OrcaScenes:
    """``PATH/<scene>.safetensors`` or ``PATH/<scene>/scene.safetensors`` (so the ``work/orca`` folder of a run).

    A scene made with another depth lives in another unit of length: it is placed by the median ratio of its input-view
    depth to the reference depth, as every method is, unless that ratio is 1 within 2 %.
    """

    name: str
    path: Path

    def version(self, options: RunOptions) -> str:
        """Changes when any file of the folder does."""
        return f"orca scenes of {self.path}, {fingerprint(self.path)}; reader 2"

    def run(self, case: SceneCase, options: RunOptions) -> MethodOutput:
        """Load and render. Raises `Unavailable` without the scene's file, `BadInput` for a broken one."""
        from orca.render.surroundings import as_shown
        from orca.scene import Scene

        file = one_of(self.path, case.name, FILE_NAMES, "scene file")
        if file.stat().st_size > MAX_BYTES:
            raise BadInput(f"{file} of {file.stat().st_size} bytes", f"at most {MAX_BYTES}", "check the file")
        scene = Scene.load(file)
        renderer = scene.renderer(options.device)
        view = renderer.render(case.camera)
        seen = (view.alpha > 0.5) & (view.depth > 0)
        if seen.mean() < 0.01:
            raise BadInput(f"{file} shows nothing in the input view", "a scene of this image", "check the file")
        low, ratio, high = (float(q) for q in np.percentile(view.depth[seen] / case.depth[seen], (16, 50, 84)))
        unit = 1.0 if abs(ratio - 1) < _SAME_UNIT else ratio
        model = {
            "anchors": scene.num_anchors,
            "bytes": scene.num_bytes,
            "placement_scale": unit,
            "placement_spread": high / low,
        }
        notes = ("from scene files; reconstructed elsewhere, which is not timed",)

        def render(camera: Camera) -> Rendering:
            return as_shown(renderer.render(_in_unit(camera, unit)), scene.render_config)

        return render_case(render, case, options, model, notes, unit=unit)


def _in_unit(camera: Camera, unit: float) -> Camera:
    """The same camera in a world whose unit is ``1 / unit`` of the case's."""
    if unit == 1.0:
        return camera
    pose = camera.world_to_camera.copy()
    pose[:3, 3] *= unit
    return replace(camera, world_to_camera=pose)
