"""Cases of image files: everything that a folder of images may hold, and what only pretends to be an image."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from bench.datasets.case import SceneCase
from bench.datasets.folder import ImageFolder
from bench.stability.case import StabilityCase
from bench.stability.outcome import FINISHED, TYPED
from bench.stability.scenes import FRAMES, picture, write_picture
from bench.trajectories import evenly_spaced

__all__ = ["FILE_CASES"]

Writer = Callable[[Path], object]


def _alpha(folder: Path) -> None:
    rgba = np.dstack([picture(), np.tile(np.linspace(0, 255, 128).astype(np.uint8), (128, 1))])
    Image.fromarray(rgba).save(folder / "alpha.png")


def _grey(folder: Path) -> None:
    Image.fromarray(picture()).convert("L").save(folder / "grey.png")


def _deep_grey(folder: Path) -> None:
    Image.fromarray(picture()[..., 0].astype(np.uint16) * 257).save(folder / "deep.png")


def _cmyk(folder: Path) -> None:
    Image.fromarray(picture()).convert("CMYK").save(folder / "cmyk.jpg", quality=95)


def _palette(folder: Path) -> None:
    Image.fromarray(picture()).quantize(16).save(folder / "palette.png")


def _rotated(folder: Path) -> None:
    exif = Image.Exif()
    exif[0x0112] = 6  # turn by a quarter
    Image.fromarray(picture(160, 96)).save(folder / "rotated.jpg", exif=exif, quality=95)


def _unicode(folder: Path) -> None:
    write_picture(folder / "schöne Aussicht 風景 🌄.png")


def _truncated(folder: Path) -> None:
    whole = write_picture(folder / "cut.png").read_bytes()
    (folder / "cut.png").write_bytes(whole[: len(whole) // 2])


def _huge_header(folder: Path) -> None:
    """A PNG whose header claims 60000x60000 pixels."""
    import struct
    import zlib

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", 60_000, 60_000, 8, 2, 0, 0, 0))
    pixels = chunk(b"IDAT", zlib.compress(b"\0" * 1000))
    (folder / "huge.png").write_bytes(b"\x89PNG\r\n\x1a\n" + header + pixels + chunk(b"IEND", b""))


def _with_depth(depth: Callable[[], np.ndarray[tuple[int, ...], np.dtype[np.generic]]]) -> Writer:
    def write(folder: Path) -> None:
        write_picture(folder / "scene.png")
        np.save(folder / "scene.depth.npy", depth())

    return write


def _sliver(width: int, height: int) -> Writer:
    return lambda folder: write_picture(folder / "sliver.png", picture(width, height))


def _only_scene(write: Writer, folder: Path) -> SceneCase:
    """The one image of a folder, with few frames."""
    write(folder)
    images = ImageFolder(folder)
    case = images.load(images.scenes()[0])
    return replace(case, eval_indices=evenly_spaced(len(case.trajectory), FRAMES))


def _file(name: str, about: str, write: Writer, expected: tuple[str, ...] = FINISHED) -> StabilityCase:
    return StabilityCase(name, "files", about, expected, expected, scene=lambda folder: _only_scene(write, folder))


_REFUSED = (TYPED,)

FILE_CASES = (
    _file("grey-file", "an 8-bit grey PNG", _grey),
    _file("alpha-file", "a PNG with an alpha channel", _alpha),
    _file("deep-file", "a 16-bit grey PNG", _deep_grey),
    _file("cmyk-file", "a CMYK JPEG", _cmyk),
    _file("palette-file", "a PNG with a palette of 16 colours", _palette),
    _file("rotated-file", "a JPEG that EXIF turns by a quarter", _rotated),
    _file("unicode-name", "a file name with umlauts, ideographs, an emoji and spaces", _unicode),
    _file("truncated-file", "half a PNG", _truncated, _REFUSED),
    _file("empty-file", "a PNG of 0 bytes", lambda folder: (folder / "empty.png").touch(), _REFUSED),
    _file("text-file", "a text with the name of a JPEG", lambda f: (f / "text.jpg").write_text("no image"), _REFUSED),
    _file("huge-header", "a PNG header that claims 60000x60000 pixels", _huge_header, _REFUSED),
    _file("pixel-wide", "an image 1 pixel wide", _sliver(1, 200), _REFUSED),
    _file("pixel-tall", "an image 1 pixel tall", _sliver(200, 1), _REFUSED),
    _file("text-depth", "a depth file that holds words", _with_depth(lambda: np.array([["no", "depth"]])), _REFUSED),
    _file("no-images", "a folder without an image", lambda folder: None, _REFUSED),
)
