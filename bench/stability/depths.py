"""Cases of the depth: broken values, wrong shapes, and geometry that no surface has."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bench.stability.case import StabilityCase
from bench.stability.outcome import FINISHED, TYPED
from bench.stability.scenes import SIZE, make_scene, object_depth, picture
from orca.conventions import Float32Array, UInt8Array

__all__ = ["DEPTH_CASES"]


def patched(value: float) -> Float32Array:
    """The usual depth with a square of something else."""
    depth = object_depth()
    depth[40:60, 50:80] = value
    return depth


def constant(value: float) -> Float32Array:
    """The same depth everywhere."""
    return np.full((SIZE, SIZE), value, np.float32)


def outlier(value: float) -> Float32Array:
    """The usual depth with one wild pixel."""
    depth = object_depth()
    depth[SIZE // 2, SIZE // 3] = value
    return depth


def noisy(spread: float) -> Float32Array:
    """The usual depth times independent log-normal noise."""
    noise = np.random.default_rng(0).normal(0.0, spread, (SIZE, SIZE))
    return (object_depth() * np.exp(noise)).astype(np.float32)


def inverted() -> Float32Array:
    """Near and far exchanged: 1 / depth, at the same median."""
    depth = object_depth()
    return (np.median(depth) ** 2 / depth).astype(np.float32)


def checkerboard() -> Float32Array:
    """A step of depth between any two neighbours."""
    y, x = np.mgrid[:SIZE, :SIZE]
    return np.where((x + y) % 2 == 0, np.float32(0.5), np.float32(1.5))


def poles() -> Float32Array:
    """One-pixel poles far in front of a wall."""
    depth = constant(1.5)
    depth[:, ::12] = 0.4
    return depth


def ramp() -> Float32Array:
    """A surface seen almost edge-on: depth grows fiftyfold from left to right."""
    return np.repeat(np.geomspace(0.1, 5.0, SIZE)[None], SIZE, axis=0).astype(np.float32)


def stairs() -> Float32Array:
    """Eight levels of depth, as a heavily quantised map has them."""
    depth = object_depth()
    nearest: Float32Array = (np.ceil(depth / depth.max() * 8) / 8 * depth.max()).astype(np.float32)
    return nearest


def pole_picture() -> UInt8Array:
    """The picture with poles of another colour."""
    rgb = picture()
    rgb[:, ::12] = (230, 40, 40)
    return rgb


def _case(
    name: str,
    about: str,
    depth: Callable[[], Float32Array],
    expected: tuple[str, ...] = FINISHED,
    image: Callable[[], UInt8Array] = picture,
) -> StabilityCase:
    return StabilityCase(name, "depth", about, expected, scene=lambda _: make_scene(image(), depth()))


_REFUSED = (TYPED,)

DEPTH_CASES = (
    _case("constant-depth", "the same depth everywhere: a flat picture", lambda: constant(1.0)),
    _case("zero-depth", "depth 0 everywhere", lambda: constant(0.0), _REFUSED),
    _case("nan-depth", "NaN everywhere", lambda: constant(np.nan), _REFUSED),
    _case("nan-patch", "NaN in a part of the depth", lambda: patched(np.nan), _REFUSED),
    _case("infinite-patch", "infinite depth in a part", lambda: patched(np.inf), _REFUSED),
    _case("negative-patch", "negative depth in a part", lambda: patched(-1.0), _REFUSED),
    _case("wrong-size-depth", "depth of half the image's size", lambda: object_depth(SIZE // 2, SIZE // 2), _REFUSED),
    _case("inverted-depth", "near and far exchanged", inverted),
    _case("noisy-depth", "depth with 20 % noise, pixel by pixel", lambda: noisy(0.2)),
    _case("far-outlier", "one pixel a million times too far", lambda: outlier(1e6)),
    _case("near-outlier", "one pixel ten thousand times too near", lambda: outlier(1e-4)),
    _case("checkerboard-depth", "a depth step between any two neighbours", checkerboard),
    _case("thin-poles", "one-pixel poles far in front of a wall", poles, image=pole_picture),
    _case("grazing-ramp", "depth that grows fiftyfold across the image", ramp),
    _case("stairs-depth", "eight levels of depth", stairs),
    _case("tiny-depth", "the scene a thousand times too small for its path", lambda: object_depth() * np.float32(1e-3)),
    _case("huge-depth", "the scene a thousand times too large for its path", lambda: object_depth() * np.float32(1e3)),
)
