"""The photographs that the scikit-image package ships: no network, no data root. The default data set."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from pathlib import Path

from bench.datasets.assemble import DEFAULT_TRAJECTORY, check_scene, default_camera, guessed_depth, uncalibrated_case
from bench.datasets.case import Dataset, SceneCase
from bench.datasets.catalogue import DatasetOptions
from bench.datasets.motorcycle import read_motorcycle
from bench.trajectories import build_trajectory, evenly_spaced
from orca.errors import Unavailable
from orca.images import load_image

__all__ = ["Photos", "open_photos"]

_FILES = {
    "motorcycle": ("motorcycle_left.png", "motorcycle_right.png", "motorcycle_disp.npz"),
    "astronaut": ("astronaut.png",),
    "chelsea": ("chelsea.png",),
    "coffee": ("coffee.png",),
    "rocket": ("rocket.jpg",),
}


def open_photos(options: DatasetOptions) -> Dataset:
    """The factory of the registry."""
    return Photos(options.trajectory or DEFAULT_TRAJECTORY)


def package_file(name: str) -> Path:
    """Path of a data file inside the installed scikit-image package; raises `Unavailable` if it has none."""
    spec = importlib.util.find_spec("skimage")
    folders = list(spec.submodule_search_locations or ()) if spec else []
    for folder in folders:
        path = Path(folder) / "data" / name
        if path.is_file():
            return path
    raise Unavailable(
        f"scikit-image's data file {name} is not in the installed package ({', '.join(folders) or 'not installed'})",
        "scikit-image >= 0.22 from a wheel, which carries its legacy data files",
        "pip install --force-reinstall scikit-image",
    )


class Photos:
    """motorcycle (true depth, real second view), astronaut, chelsea, coffee and rocket (heuristic depth)."""

    name = "photos"

    def __init__(self, trajectory: str = DEFAULT_TRAJECTORY) -> None:
        self._trajectory = trajectory

    def scenes(self) -> Sequence[str]:
        """Scene names; the one with ground truth first."""
        return tuple(_FILES)

    def load(self, scene: str) -> SceneCase:
        """Read one photograph. Raises `Unknown` for a wrong name, `Unavailable` if the package lacks its file."""
        files = [package_file(file) for file in _FILES[check_scene(scene, self.scenes(), self.name)]]
        if scene == "motorcycle":
            return self._motorcycle(*files)
        image = load_image(files[0])
        camera = default_camera(image)
        depth, source = guessed_depth(image, camera)
        return uncalibrated_case(self.name, scene, image, camera, depth, source, self._trajectory)

    def _motorcycle(self, *files: Path) -> SceneCase:
        """The calibrated pair: measured depth, and the second photograph as a true view."""
        pair = read_motorcycle(*files)
        trajectory = build_trajectory(self._trajectory, pair.camera)
        return SceneCase(
            dataset=self.name,
            name="motorcycle",
            image=pair.left,
            camera=pair.camera,
            depth=pair.depth,
            depth_source="Middlebury true disparity",
            depth_is_metric=True,
            depth_is_measured=True,
            fov_source="calibrated",
            trajectory=trajectory,
            eval_indices=evenly_spaced(len(trajectory)),
            true_views=(pair.second,),
        )
