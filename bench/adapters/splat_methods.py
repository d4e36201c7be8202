"""Methods that hand over splats: rendered here, along the case's cameras, with one renderer for all of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.adapters.adapter import MethodOutput, RunOptions
from bench.adapters.external import ExternalSpec
from bench.adapters.gaussian_ply import read_gaussian_ply
from bench.adapters.sources import fingerprint, one_of, scene_file
from bench.adapters.splat_cloud import SplatCloud
from bench.adapters.views import render_case
from bench.adapters.vistadream_scene import read_vistadream_scene
from bench.cameras_io import find_camera_file, read_camera_file
from bench.datasets.case import SceneCase

__all__ = ["SCENE_NAMES", "SplatMethod", "open_ply", "open_vistadream_scene", "read_ply_scene"]

# Per stage, the names that the two published generations of VistaDream's code write.
SCENE_NAMES = {
    "refine": ("{scene}/scene.refine.pth", "{scene}/refine.scene.pth", "{scene}/scene.pth", "{scene}.pth"),
    "coarse": ("{scene}/scene.coarse.pth", "{scene}/coarse.scene.pth"),
}


def open_ply(spec: ExternalSpec) -> SplatMethod:
    """The factory of kind ``ply``."""
    spec.no_options()

    def read(scene: str) -> SplatCloud:
        return read_ply_scene(scene_file(spec.path, scene, ".ply", "splat file"))

    return SplatMethod(spec.name, spec.path, "3D Gaussian splats", read)


def open_vistadream_scene(spec: ExternalSpec) -> SplatMethod:
    """The factory of kind ``vistadream-scene``."""
    stage = spec.choice("stage", ("refine", "coarse"), "refine")

    def read(scene: str) -> SplatCloud:
        return read_vistadream_scene(one_of(spec.path, scene, SCENE_NAMES[stage], f"{stage} scene of VistaDream"))

    return SplatMethod(spec.name, spec.path, f"VistaDream scene, {stage}", read)


def read_ply_scene(path: Path) -> SplatCloud:
    """The splats of a .ply.

    Their world is that of the input view (OpenCV axes), unless ``<name>.json``, or a camera file in a folder of the
    scene's own, gives cameras in the splats' world: the first of them is the input view.

    Raises:
        BadInput: a broken file of either kind.
    """
    cloud = read_gaussian_ply(path)
    beside = path.with_suffix(".json")
    alone = len(list(path.parent.glob("*.ply"))) == 1
    file = beside if beside.is_file() else find_camera_file(path.parent) if alone else None
    return cloud if file is None else cloud.seen_from(read_camera_file(file)[0].camera.world_to_camera)


@dataclass(frozen=True)
class SplatMethod:
    """Splats of each scene, placed by the median depth ratio of the input view and rendered over black.

    Attributes:
        name: the row's name.
        path: the folder, for the version.
        kind: what the files are, in words.
        read: scene name -> its splats; raises `OrcaError`.
    """

    name: str
    path: Path
    kind: str
    read: Callable[[str], SplatCloud]

    def version(self, options: RunOptions) -> str:
        """Changes when any file of the folder does."""
        return f"{self.kind} of {self.path}, {fingerprint(self.path)}; splat renderer 1"

    def run(self, case: SceneCase, options: RunOptions) -> MethodOutput:
        """Read, place and render. Raises `Unavailable` or `BadInput` for the scene's file."""
        from bench.splatting import place, render_cloud

        options.progress("read", 0, 1)
        cloud, placement = place(self.read(case.name), case.camera, case.depth)
        model: dict[str, Any] = {
            "anchors": len(cloud),
            "bytes": cloud.num_bytes,
            "placement_scale": placement.scale,
            "placement_spread": placement.spread,
            "splats_dropped": cloud.dropped,
        }
        notes = [f"{self.kind}, rendered here; fitted elsewhere, which is not timed"]
        if cloud.dropped:
            notes.append(f"{cloud.dropped} splats with values that are not finite left out")
        return render_case(lambda camera: render_cloud(cloud, camera), case, options, model, notes)
