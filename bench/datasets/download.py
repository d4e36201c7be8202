"""Fills a data root from the public sources: what is there stays, what comes is checked, what cannot is named."""

from __future__ import annotations

import hashlib
import urllib.error
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from PIL import Image as PillowImage

from bench.datasets.archives import unpack
from bench.datasets.fetch import Fetcher, sha256_of
from bench.datasets.manifest import DIV2K, IMAGES, REALMDREAMER_SCENES, VIDEOS, Image, Video, depth_video_url
from bench.store import write_json
from orca.conventions import UInt8Array
from orca.errors import BadInput, OrcaError, Unavailable
from orca.images import load_image, save_image

__all__ = ["SETS", "Item", "download", "pixels_sha256"]

SETS = ("realmdreamer", "vistadream", "div2k", "weights")
_IMAGE_SIDE = 512
_MAX_IMAGE_BYTES = 64 * 2**20
_MAX_UNPACKED_BYTES = 512 * 2**20
Report = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Item:
    """What became of one file.

    Attributes:
        path: where it is, or belongs.
        state: "here" before, "fetched" now, "missing" (could be fetched), "by hand" (cannot be), or "failed".
        source: its address; "" for what comes with this package.
        detail: its hash, or what went wrong.
    """

    path: Path
    state: str
    source: str = ""
    detail: str = ""


def download(
    what: str,
    root: Path,
    fetcher: Fetcher | None = None,
    dry_run: bool = False,
    report: Report = lambda name, done, total: None,
) -> list[Item]:
    """Fetch what is missing of one of `SETS` into a data root. Files that are there are checked and never replaced.

    Args:
        what: "realmdreamer", "vistadream", "div2k", or "weights" (of the learned metrics).
        root: the data root.
        fetcher: how; over https when left out.
        dry_run: only say what would be fetched.
        report: hears of progress as (file name, bytes, bytes in all).

    Raises:
        BadInput: no such set.
        Unavailable: no network; what was fetched before stays.
    """
    steps = {"realmdreamer": _realmdreamer, "vistadream": _vistadream, "div2k": _div2k, "weights": _weights}
    if what not in steps:
        raise BadInput(f"'{what}'", ", ".join(SETS), "choose one of these; photos and synthetic need no download")
    return steps[what](Path(root), None if dry_run else fetcher or Fetcher(), report)


def _vistadream(root: Path, fetcher: Fetcher | None, report: Report) -> list[Item]:
    items = [_tried(root / v.path, v.url, partial(_video, root, v, fetcher, report)) for v in VIDEOS]
    for scene in REALMDREAMER_SCENES:
        path = root / "vistadream" / "dpt" / f"{scene}.mp4"
        state = "here" if path.is_file() else "by hand"
        items.append(Item(path, state, depth_video_url(scene), "no pinned hash; only `bench depth` needs it"))
    return items


def _video(root: Path, video: Video, fetcher: Fetcher | None, report: Report) -> Item:
    path = root / video.path
    if path.is_file():
        found = sha256_of(path)
        if found != video.sha256:
            raise BadInput(f"{path} has SHA-256 {found}", video.sha256, "move it away, and download again")
        return Item(path, "here", video.url, video.sha256)
    if fetcher is None:
        return Item(path, "missing", video.url, video.sha256)
    fetcher.fetch(video.url, path, video.sha256, video.size, lambda done, total: report(path.name, done, total))
    return Item(path, "fetched", video.url, video.sha256)


def _realmdreamer(root: Path, fetcher: Fetcher | None, report: Report) -> list[Item]:
    facts = root / "realmdreamer" / "scenes.json"
    here = facts.is_file()
    if not here and fetcher is not None:
        write_json(facts, REALMDREAMER_SCENES)
    state = "here" if here else "missing" if fetcher is None else "fetched"
    items = [Item(facts, state, "", "comes with this package")]
    items += [_tried(root / i.path, i.url, partial(_image, root, i, fetcher, report)) for i in IMAGES]
    for scene in REALMDREAMER_SCENES:
        path = root / "realmdreamer" / "depth" / f"{scene}.png"
        how = "python -m bench depth, from vistadream/dpt/*.mp4 (see: bench download vistadream)"
        items.append(Item(path, "here" if path.is_file() else "by hand", depth_video_url(scene), how))
    return items


def _image(root: Path, image: Image, fetcher: Fetcher | None, report: Report) -> Item:
    path = root / image.path
    if path.is_file():
        found = pixels_sha256(load_image(path))
        if found != image.pixels_sha256:
            raise BadInput(f"{path} has pixels of SHA-256 {found}", image.pixels_sha256, "move it away, and try again")
        return Item(path, "here", image.url, f"pixels {image.pixels_sha256}")
    if fetcher is None:
        return Item(path, "missing", image.url, f"pixels {image.pixels_sha256}")
    original = path.with_name(f".{path.stem}-original{Path(image.url).suffix}")
    try:
        fetcher.fetch(image.url, original, None, _MAX_IMAGE_BYTES, lambda done, total: report(path.name, done, total))
        for pixels in _conversions(load_image(original)):
            if pixels_sha256(pixels) == image.pixels_sha256:
                save_image(path, pixels)
                return Item(path, "fetched", image.url, f"pixels {image.pixels_sha256}")
    finally:
        original.unlink(missing_ok=True)
    raise BadInput(
        f"{image.url}: its pixels at {_IMAGE_SIDE}x{_IMAGE_SIDE} are not those pinned",
        f"SHA-256 {image.pixels_sha256} over {_IMAGE_SIDE}x{_IMAGE_SIDE} RGB",
        f"another decoder may round otherwise: look at the image, convert it by hand (no alpha, resized by area) and "
        f"put it at {path}; the figures measured with it may differ in the last digits",
    )


def _conversions(image: UInt8Array) -> Sequence[UInt8Array]:
    """The image at 512x512, by the two implementations of resizing by area in use."""
    size = (_IMAGE_SIDE, _IMAGE_SIDE)
    if image.shape[:2] == size:
        return (image,)
    by_opencv = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    by_pillow = np.asarray(PillowImage.fromarray(image).resize(size, PillowImage.Resampling.BOX))
    return (by_opencv, by_pillow)


def pixels_sha256(image: UInt8Array) -> str:
    """SHA-256 over the RGB bytes of an image [H, W, 3], row by row."""
    return hashlib.sha256(np.ascontiguousarray(image).tobytes()).hexdigest()


def _div2k(root: Path, fetcher: Fetcher | None, report: Report) -> list[Item]:
    folder = root / DIV2K.folder
    missing = [name for name in DIV2K.members if not (folder / name).is_file()]
    if not missing:
        return [Item(folder / name, "here", DIV2K.url) for name in DIV2K.members]
    if fetcher is None:
        return [Item(folder / name, "missing", DIV2K.url, f"archive {DIV2K.sha256}") for name in missing]
    archive = folder / Path(DIV2K.url).name
    if not archive.is_file():
        fetcher.fetch(
            DIV2K.url, archive, DIV2K.sha256, DIV2K.size, lambda done, total: report(archive.name, done, total)
        )
    elif sha256_of(archive) != DIV2K.sha256:
        raise BadInput(f"{archive} with another SHA-256", DIV2K.sha256, "delete it, and download again")
    wanted = set(missing)
    written = unpack(archive, folder, _MAX_UNPACKED_BYTES, lambda name: name in wanted)
    absent = sorted(wanted - {path.relative_to(folder).as_posix() for path in written})
    if absent:
        raise BadInput(f"{archive} without {absent[0]} ({len(absent)} missing)", "all 100 images", "fetch it again")
    archive.unlink()
    return [Item(path, "fetched", DIV2K.url) for path in written]


def _weights(root: Path, fetcher: Fetcher | None, report: Report) -> list[Item]:
    from bench.metrics.weights_fetch import fetch_weights

    return [Item(*found) for found in fetch_weights(root / "weights", fetcher, report)]


def _tried(path: Path, url: str, step: Callable[[], Item]) -> Item:
    """What a step gives; its failure as an item, so that the other files are still fetched.

    A failure to reach the network at all is raised: the others would fail the same way, one after another.
    """
    try:
        return step()
    except Unavailable as error:
        if not isinstance(error.__cause__, urllib.error.HTTPError):
            raise
        return Item(path, "failed", url, str(error))
    except OrcaError as error:
        return Item(path, "failed", url, str(error))
