"""Any folder of images, with depth maps beside them where there are some.

- Images: ``*.png, *.jpg, *.jpeg, *.webp, *.bmp, *.tif, *.tiff``; the scene's name is the file's stem.
- Depth of ``<stem>.<ext>``: ``<stem>.depth.png``, ``<stem>.depth.npy``, ``<stem>_depth.png`` or ``<stem>_depth.npy``
  (first found): positive z-depth in any unit, of the image's size; a PNG has one channel of 8 or 16 bits, an array
  [H, W] holds integers or floats. It counts as proportional to true depth. Without one the weight-free
  heuristic guesses.
- Field of view: 60 degrees for every image.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

from bench.datasets.assemble import (
    DEFAULT_TRAJECTORY,
    check_scene,
    checked_depth,
    default_camera,
    guessed_depth,
    in_scene_radii,
    uncalibrated_case,
)
from bench.datasets.case import Dataset, SceneCase
from bench.datasets.catalogue import DatasetOptions
from orca.array_file import read_npy, read_png
from orca.conventions import Float32Array, UInt8Array
from orca.errors import BadInput, Unavailable
from orca.images import load_image

__all__ = ["ImageFolder", "open_folder"]

_IMAGES = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tif", ".tiff")
_DEPTHS = (".depth.png", ".depth.npy", "_depth.png", "_depth.npy")


def open_folder(options: DatasetOptions) -> Dataset:
    """The factory of the registry; raises `BadInput` without a folder."""
    if options.images is None:
        raise BadInput("data set 'folder' without a folder", "--images DIR", "say where the images are: --images DIR")
    return ImageFolder(options.images, options.trajectory or DEFAULT_TRAJECTORY)


class ImageFolder:
    """The images of one folder, not of its sub-folders."""

    name = "folder"

    def __init__(self, folder: Path, trajectory: str = DEFAULT_TRAJECTORY) -> None:
        self._folder = Path(folder)
        self._trajectory = trajectory

    def scenes(self) -> Sequence[str]:
        """Stems of the images, sorted. Raises `Unavailable` without any, `BadInput` where two share a stem."""
        return tuple(self._images())

    def load(self, scene: str) -> SceneCase:
        """Read one image and its depth. Raises `Unknown` for a wrong name, `BadInput` for a broken file."""
        images = self._images()
        image = load_image(images[scene if scene in images else check_scene(scene, tuple(images), self.name)])
        camera = default_camera(image)
        beside = next((path for path in self._depths(scene) if path.is_file()), None)
        if beside is None:
            depth, source = guessed_depth(image, camera)
        else:
            depth, _ = in_scene_radii(_read_depth(beside, image), camera)
            source = f"file {beside.name}"
        path, metric = self._trajectory, beside is not None
        return uncalibrated_case(self.name, scene, image, camera, depth, source, path, depth_is_metric=metric)

    def _depths(self, scene: str) -> list[Path]:
        return [self._folder / (scene + ending) for ending in _DEPTHS]

    def _images(self) -> dict[str, Path]:
        if not self._folder.is_dir():
            raise BadInput(f"no such folder: {self._folder}", "a folder of images", "check --images")
        return _images_of(self._folder, self._folder.stat().st_mtime_ns)


@lru_cache(maxsize=4)
def _images_of(folder: Path, changed_ns: int) -> dict[str, Path]:
    """Stem -> image, sorted; a folder is looked through again only when a file came or went (``changed_ns``)."""
    found: dict[str, Path] = {}
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() not in _IMAGES or path.name.lower().endswith(_DEPTHS) or not path.is_file():
            continue
        if path.stem in found:
            raise BadInput(
                f"two images of one name: {found[path.stem].name} and {path.name}",
                "one image per stem",
                "rename one of them",
            )
        found[path.stem] = path
    if not found:
        raise Unavailable(f"no image in {folder}", f"files ending in {', '.join(_IMAGES)}", "put images there")
    return found


def _read_depth(path: Path, image: UInt8Array) -> Float32Array:
    if path.suffix == ".npy":
        return checked_depth(read_npy(path), image, str(path))
    return checked_depth(read_png(path), image, str(path))
