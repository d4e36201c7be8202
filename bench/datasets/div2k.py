"""DIV2K validation, x2 bicubic: 100 photographs, 0801 to 0900, with the depth of a small network.

Files under ``<data_root>/div2k``: ``DIV2K_valid_LR_bicubic/X2/0801x2.png`` and so on, as the archive of the data set
unpacks, or ``X2/0801x2.png``. Depth: ``<data_root>/weights/tcmonodepth_small_384.onnx`` (TCMonoDepth, relative inverse
depth), which is estimated and not proportional to true depth; field of view 60 degrees.

``div2k`` is all 100 of them or nothing. ``div2k-subset`` is whatever is here: its name says so in every table, since a
handful that happened to be at hand is not the benchmark.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bench.datasets.assemble import (
    DEFAULT_TRAJECTORY,
    check_scene,
    checked_depth,
    default_camera,
    in_scene_radii,
    uncalibrated_case,
)
from bench.datasets.case import Dataset, SceneCase
from bench.datasets.catalogue import DatasetOptions, resolve_data_root
from orca.camera import Camera
from orca.conventions import Float32Array, UInt8Array, to_float
from orca.errors import Unavailable
from orca.images import load_image

__all__ = ["NETWORK", "SCENES", "Div2k", "open_div2k", "open_div2k_subset"]

SCENES = tuple(f"{number:04d}" for number in range(801, 901))
NETWORK = "tcmonodepth_small_384.onnx"
_FOLDERS = ("DIV2K_valid_LR_bicubic/X2", "X2")
_NETWORK_SIDE = 384


def open_div2k(options: DatasetOptions) -> Dataset:
    """The factory of the registry: all 100 images."""
    return Div2k(resolve_data_root(options.data_root), options.trajectory or DEFAULT_TRAJECTORY, whole=True)


def open_div2k_subset(options: DatasetOptions) -> Dataset:
    """The factory of the registry: the images that are here."""
    return Div2k(resolve_data_root(options.data_root), options.trajectory or DEFAULT_TRAJECTORY, whole=False)


class Div2k:
    """The images under ``<data_root>/div2k``; a scene's name is its number.

    Args:
        data_root: folder with ``div2k`` and ``weights``.
        trajectory: name of a path, or a .json camera file.
        whole: ask for all 100 images.
    """

    def __init__(self, data_root: Path, trajectory: str = DEFAULT_TRAJECTORY, whole: bool = True) -> None:
        self.name = "div2k" if whole else "div2k-subset"
        self._root, self._whole, self._trajectory = Path(data_root), whole, trajectory

    def scenes(self) -> Sequence[str]:
        """Numbers in order. Raises `Unavailable` where images are missing (all, for the subset)."""
        here = tuple(scene for scene in SCENES if self._file(scene) is not None)
        if len(here) == len(SCENES) or (here and not self._whole):
            return here
        missing = next(scene for scene in SCENES if scene not in here)
        raise Unavailable(
            f"{len(here)} of the {len(SCENES)} images of DIV2K are in {self._root / 'div2k'}; {missing}x2.png is not",
            f"{_FOLDERS[0]}/0801x2.png to 0900x2.png",
            "python -m bench download div2k"
            + (", or --dataset div2k-subset for the images that are here" if here else ""),
        )

    def load(self, scene: str) -> SceneCase:
        """Read one image and estimate its depth.

        Raises:
            Unknown: no such scene.
            BadInput: a broken image.
            Unavailable: the depth network is not here.
        """
        file = self._file(check_scene(scene, self.scenes(), self.name))
        if file is None:  # deleted between the two lines
            raise Unavailable(f"no image of scene {scene}", f"{scene}x2.png", "python -m bench download div2k")
        image = load_image(file)
        camera = default_camera(image)
        depth, source = self._depth(image, camera)
        return uncalibrated_case(self.name, scene, image, camera, depth, source, self._trajectory)

    def _file(self, scene: str) -> Path | None:
        candidates = (self._root / "div2k" / folder / f"{scene}x2.png" for folder in _FOLDERS)
        return next((path for path in candidates if path.is_file()), None)

    def _depth(self, image: UInt8Array, camera: Camera) -> tuple[Float32Array, str]:
        from orca.priors.onnx import OnnxDepth

        network = OnnxDepth(self._root / "weights" / NETWORK, _NETWORK_SIDE, _NETWORK_SIDE, value_range="255")
        estimate = network.estimate(to_float(image), camera)
        depth, _ = in_scene_radii(checked_depth(estimate.depth, image, f"of {NETWORK}"), camera)
        return depth, f"{estimate.source} (TCMonoDepth small)"
