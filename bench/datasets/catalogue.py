"""Which data sets there are, where their files lie, and how one is opened."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from bench.datasets.case import Dataset
from orca.errors import BadInput
from orca.registry import Registry

__all__ = ["DATASETS", "DATASET_DESCRIPTIONS", "DatasetOptions", "open_dataset", "resolve_data_root"]


@dataclass(frozen=True)
class DatasetOptions:
    """What a data set may be told.

    Attributes:
        data_root: folder with one sub-folder per data set; None for the usual places (`resolve_data_root`).
        images: folder of images, for ``folder``.
        trajectory: name of a path or a .json camera file; None for the data set's own.
    """

    data_root: Path | None = None
    images: Path | None = None
    trajectory: str | None = None


DATASETS: Registry[Callable[[DatasetOptions], Dataset]] = Registry(
    "dataset",
    {
        "photos": "bench.datasets.photos:open_photos",
        "realmdreamer": "bench.datasets.realmdreamer:open_realmdreamer",
        "synthetic": "bench.datasets.synthetic:open_synthetic",
        "synthetic-unseen": "bench.datasets.synthetic:open_unseen",
        "div2k": "bench.datasets.div2k:open_div2k",
        "div2k-subset": "bench.datasets.div2k:open_div2k_subset",
        "folder": "bench.datasets.folder:open_folder",
    },
)

DATASET_DESCRIPTIONS: dict[str, str] = {
    "photos": "5 photographs of the scikit-image package, one with true depth and a real second view; no download",
    "realmdreamer": "the 11 RealmDreamer images with depth, along VistaDream's published path; needs a data root",
    "synthetic": "20 seeds of textured planes, boxes and poles, twice: exact depth, views, hidden masks; no download",
    "synthetic-unseen": "the same from 20 other seeds, on which nothing was tuned",
    "div2k": "the 100 DIV2K validation images at x2, with a small network's depth; needs a data root",
    "div2k-subset": "those of the 100 that are here; not to be reported as DIV2K",
    "folder": "any folder of images (--images DIR), with depth maps beside them where you have them",
}


def open_dataset(
    name: str, *, data_root: Path | None = None, images: Path | None = None, trajectory: str | None = None
) -> Dataset:
    """Open a data set by name.

    Raises:
        Unknown: no such data set or trajectory.
        BadInput: ``images`` for another data set than ``folder``, or none for that.
        Unavailable: its files are not here.
    """
    factory = DATASETS.get(name)
    if images is not None and name != "folder":
        raise BadInput(
            f"a folder of images together with the data set '{name}'",
            "--images only with --dataset folder",
            "leave out --images, or use --dataset folder",
        )
    return factory(DatasetOptions(data_root, images, trajectory))


def resolve_data_root(explicit: Path | None) -> Path:
    """Where data lie: the given folder, else $ORCA_DATA_ROOT, else ./data if it exists, else the user's cache."""
    if explicit is not None:
        return Path(explicit)
    configured = os.environ.get("ORCA_DATA_ROOT")
    if configured:
        return Path(configured)
    local = Path("data")
    if local.is_dir():
        return local
    cache = os.environ.get("XDG_CACHE_HOME")
    return (Path(cache) if cache else Path.home() / ".cache") / "orca"
