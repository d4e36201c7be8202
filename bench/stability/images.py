"""Cases of the image: pictures with too little or too much in them, and sizes at the ends of the range."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from bench.adapters.adapter import MethodOutput
from bench.datasets.assemble import guessed_depth
from bench.datasets.case import SceneCase
from bench.stability.case import StabilityCase
from bench.stability.outcome import EXACT, FINISHED
from bench.stability.scenes import HFOV_DEG, SIZE, make_scene, object_depth, picture
from orca.camera import Camera
from orca.conventions import UInt8Array, to_uint8

__all__ = ["IMAGE_CASES"]

_COLOUR_TOLERANCE = 6  # of 255
_SOLID = 0.99  # coverage from which on a colour is not mixed with the background's


def flat(level: int) -> UInt8Array:
    """One grey level everywhere."""
    return np.full((SIZE, SIZE, 3), level, np.uint8)


def only_colour(level: int, case: SceneCase, output: MethodOutput) -> str | None:
    """A scene of one colour shows that colour wherever it shows anything."""
    if output.coverage is None:
        return None
    shown = output.frames[output.coverage >= _SOLID].astype(int)
    worst = int(np.abs(shown - level).max(initial=0))
    return f"a colour {worst} levels off the only one there is" if worst > _COLOUR_TOLERANCE else None


def noise() -> UInt8Array:
    """Independent pixels."""
    return np.asarray(np.random.default_rng(0).integers(0, 256, (SIZE, SIZE, 3)), np.uint8)


def pixel_checkerboard() -> UInt8Array:
    """Black and white by turns, pixel by pixel: the highest frequency there is."""
    y, x = np.mgrid[:SIZE, :SIZE]
    return np.repeat((255 * ((x + y) % 2)).astype(np.uint8)[..., None], 3, axis=2)


def thin_lines() -> UInt8Array:
    """One-pixel wires in all directions over the picture."""
    rgb = picture()
    rgb[::16] = rgb[:, ::16] = 0
    diagonal = np.arange(SIZE)
    rgb[diagonal, diagonal] = 255
    return rgb


def lone_pixels() -> UInt8Array:
    """Single bright pixels on black."""
    rgb = flat(0)
    rgb[5::17, 3::19] = 255
    return rgb


def mirrored() -> UInt8Array:
    """The left half and its mirror image, with a black seam: edges that repeat at the same depth."""
    half = picture()[:, : SIZE // 2]
    rgb = np.concatenate([half, half[:, ::-1]], axis=1)
    rgb[:, SIZE // 2 - 1 : SIZE // 2 + 1] = 0
    return np.ascontiguousarray(rgb)


def primaries() -> UInt8Array:
    """Quadrants of pure red, green, blue and yellow: colours at both ends of the range."""
    rgb = flat(0)
    half = SIZE // 2
    rgb[:half, :half, 0] = rgb[:half, half:, 1] = rgb[half:, :half, 2] = 255
    rgb[half:, half:, :2] = 255
    return rgb


def sky(share: float) -> UInt8Array:
    """Clear sky over dark ground, the sky taking this share of the height."""
    top = np.linspace([0.45, 0.65, 0.95], [0.75, 0.85, 1.0], SIZE)[:, None, :]
    colour = np.repeat(top, SIZE, axis=1)
    ground = int(SIZE * share)
    stripes = 0.2 + 0.1 * (np.arange(SIZE) // 5 % 2)
    colour[ground:] = np.stack([stripes, 1.3 * stripes, 0.6 * stripes], axis=1)[None]
    return to_uint8(colour)


def guessed(image: Callable[[], UInt8Array]) -> SceneCase:
    """A picture with the depth that the weight-free heuristic guesses."""
    rgb = image()
    camera = Camera.from_fov(rgb.shape[1], rgb.shape[0], HFOV_DEG)
    return make_scene(rgb, guessed_depth(rgb, camera)[0], camera=camera)


def _picture(name: str, about: str, image: Callable[[], UInt8Array]) -> StabilityCase:
    return StabilityCase(name, "image", about, FINISHED, scene=lambda _: make_scene(image()))


def _one_colour(name: str, about: str, level: int) -> StabilityCase:
    def scene(folder: Path) -> SceneCase:
        return make_scene(flat(level))

    return StabilityCase(name, "image", about, (EXACT,), scene=scene, check=partial(only_colour, level))


def _guessed(name: str, about: str, image: Callable[[], UInt8Array]) -> StabilityCase:
    return StabilityCase(name, "image", about, FINISHED, scene=lambda _: guessed(image))


def _sized(name: str, about: str, width: int, height: int) -> StabilityCase:
    def scene(folder: Path) -> SceneCase:
        return make_scene(picture(width, height), object_depth(width, height))

    return StabilityCase(name, "image", about, FINISHED, scene=scene)


IMAGE_CASES = (
    _one_colour("constant-grey", "one grey everywhere (textureless)", 128),
    _one_colour("black", "all black", 0),
    _one_colour("white", "all white", 255),
    _picture("noise", "independent pixels", noise),
    _picture("pixel-checkerboard", "black and white by turns, pixel by pixel", pixel_checkerboard),
    _picture("thin-lines", "one-pixel wires in all directions", thin_lines),
    _picture("lone-pixels", "single bright pixels on black", lone_pixels),
    _picture("mirror-edges", "an image and its mirror image, with a seam", mirrored),
    _picture("primaries", "pure red, green, blue, yellow", primaries),
    _guessed("all-sky", "nothing but clear sky, depth guessed from the picture", lambda: sky(1.0)),
    _guessed("mostly-sky", "90 % clear sky, depth guessed from the picture", lambda: sky(0.9)),
    _sized("smallest", "16x16 pixels, the smallest image", 16, 16),
    _sized("odd-sizes", "131x97 pixels", 131, 97),
    _sized("wide", "512x16 pixels", 512, 16),
    _sized("tall", "16x512 pixels", 16, 512),
    _sized("large", "1024x768 pixels", 1024, 768),
)
