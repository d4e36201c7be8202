"""Procedural textures: colour as a function of position on a surface, exact at any resolution.

Gradients, stripes and tiles continue under an occluder as they began; noise, patches and blobs do not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orca.conventions import Float64Array

__all__ = ["PREDICTABLE", "UNPREDICTABLE", "Texture", "random_texture"]

PREDICTABLE = ("gradient", "stripes", "tiles")
UNPREDICTABLE = ("noise", "patches", "blobs")

_HASH = (np.uint32(0x9E3779B1), np.uint32(0x85EBCA77), np.uint32(0xC2B2AE3D), np.uint32(0x27D4EB2F))


@dataclass(frozen=True, eq=False)
class Texture:
    """A colour for every point (u, v) of a surface.

    Attributes:
        kind: one of `PREDICTABLE` or `UNPREDICTABLE`.
        palette: the three colours it is made of, [3, 3] in [0, 1].
        period: length of one repetition, or size of one feature, in units of u and v.
        angle: orientation in radians.
        phase: offset of the pattern in u and v.
        key: seeds the unpredictable ones.
    """

    kind: str
    palette: Float64Array
    period: float
    angle: float
    phase: tuple[float, float]
    key: int

    def colours(self, u: Float64Array, v: Float64Array) -> Float64Array:
        """Colours in [0, 1] at points u, v [n], [n, 3]."""
        cos, sin = np.cos(self.angle), np.sin(self.angle)
        a = (cos * u + sin * v + self.phase[0]) / self.period
        b = (-sin * u + cos * v + self.phase[1]) / self.period
        return _PATTERNS[self.kind](self, a, b)


def random_texture(kind: str, random: np.random.Generator) -> Texture:
    """A texture of a kind with everything else drawn from ``random``."""
    base = random.uniform(0.25, 0.75, 3)
    palette = np.clip(base + random.uniform(-0.22, 0.22, (3, 3)), 0.03, 0.97)
    low, high = _PERIODS[kind]
    phase = random.uniform(0.0, 10.0, 2)
    angle = float(random.uniform(0.0, np.pi))
    return Texture(
        kind,
        palette,
        float(random.uniform(low, high)),
        angle,
        (float(phase[0]), float(phase[1])),
        int(random.integers(2**31)),
    )


def _gradient(texture: Texture, a: Float64Array, b: Float64Array) -> Float64Array:
    """A slow ramp of colour along two directions."""
    return _mix3(texture.palette, 0.5 + 0.5 * np.sin(a), 0.5 + 0.5 * np.sin(0.7 * b))


def _stripes(texture: Texture, a: Float64Array, b: Float64Array) -> Float64Array:
    """Parallel bands with soft edges; every other one of another colour."""
    wave = 0.5 + 0.5 * np.tanh(4.0 * np.sin(2 * np.pi * a))
    other = 0.5 + 0.5 * np.tanh(4.0 * np.sin(np.pi * a))
    return _mix3(texture.palette, wave, 0.6 * other)


def _tiles(texture: Texture, a: Float64Array, b: Float64Array) -> Float64Array:
    """Squares of two colours with joints of a third."""
    checker = 0.5 + 0.5 * np.tanh(6.0 * np.sin(np.pi * a) * np.sin(np.pi * b))
    joint = np.minimum(np.abs(np.sin(np.pi * a)), np.abs(np.sin(np.pi * b)))
    return _mix3(texture.palette, checker, np.exp(-((joint / 0.12) ** 2)))


def _noise(texture: Texture, a: Float64Array, b: Float64Array) -> Float64Array:
    """Smooth value noise of four octaves."""
    channels = [
        sum(0.5**k * _value_noise(a * 2**k, b * 2**k, texture.key + 7 * c + k) for k in range(4)) for c in (0, 1)
    ]
    first, second = (np.clip(0.5 + 0.9 * (np.asarray(x) / 1.875 - 0.5), 0, 1) for x in channels)
    return _mix3(texture.palette, first, second)


def _patches(texture: Texture, a: Float64Array, b: Float64Array) -> Float64Array:
    """Voronoi cells, each of a colour of its own."""
    ia, ib = np.floor(a), np.floor(b)
    best = np.full(a.shape, np.inf)
    first, second = np.zeros(a.shape), np.zeros(a.shape)
    for da in (-1, 0, 1):
        for db in (-1, 0, 1):
            ca, cb = ia + da, ib + db
            distance = (ca + _lattice(ca, cb, texture.key) - a) ** 2 + (cb + _lattice(ca, cb, texture.key + 1) - b) ** 2
            nearer = distance < best
            best = np.where(nearer, distance, best)
            first = np.where(nearer, _lattice(ca, cb, texture.key + 2), first)
            second = np.where(nearer, _lattice(ca, cb, texture.key + 3), second)
    return _mix3(texture.palette, first, second)


def _blobs(texture: Texture, a: Float64Array, b: Float64Array) -> Float64Array:
    """Round spots of random size and colour on an even ground."""
    ia, ib = np.floor(a), np.floor(b)
    radius = 0.12 + 0.3 * _lattice(ia, ib, texture.key)
    distance = np.hypot(a - ia - 0.5, b - ib - 0.5)
    spot = 0.5 - 0.5 * np.tanh(30.0 * (distance - radius))
    return _mix3(texture.palette, spot * _lattice(ia, ib, texture.key + 1), spot)


_PATTERNS: dict[str, Callable[[Texture, Float64Array, Float64Array], Float64Array]] = {
    "gradient": _gradient,
    "stripes": _stripes,
    "tiles": _tiles,
    "noise": _noise,
    "patches": _patches,
    "blobs": _blobs,
}

# Shortest and longest period, in the scene's unit (the back wall is 3 away and 256 px see 3.5 of it).
_PERIODS = {
    "gradient": (0.6, 1.2),
    "stripes": (0.2, 0.4),
    "tiles": (0.15, 0.3),
    "noise": (0.3, 0.6),
    "patches": (0.12, 0.3),
    "blobs": (0.15, 0.35),
}


def _mix3(palette: Float64Array, first: Float64Array, second: Float64Array) -> Float64Array:
    """From colour 0 to colour 1 by ``first``, then towards colour 2 by ``second``, [n, 3]."""
    mixed = palette[0] + first[..., None] * (palette[1] - palette[0])
    return np.asarray(mixed + second[..., None] * (palette[2] - mixed))


def _lattice(a: Float64Array, b: Float64Array, key: int) -> Float64Array:
    """A number in [0, 1) for every whole (a, b): the same on every machine."""
    x, y = a.astype(np.int64).astype(np.uint32), b.astype(np.int64).astype(np.uint32)
    with np.errstate(over="ignore"):
        h: NDArray[np.uint32] = x * _HASH[0] ^ y * _HASH[1] ^ np.uint32(key & 0xFFFFFFFF) * _HASH[2]
        h = (h ^ (h >> np.uint32(15))) * _HASH[3]
        h = (h ^ (h >> np.uint32(13))) * _HASH[1]
        h = h ^ (h >> np.uint32(16))
    return h.astype(np.float64) / 2.0**32


def _value_noise(a: Float64Array, b: Float64Array, key: int) -> Float64Array:
    """Random values at whole (a, b), smoothly interpolated between them."""
    ia, ib = np.floor(a), np.floor(b)
    fa, fb = a - ia, b - ib
    fa, fb = fa * fa * (3 - 2 * fa), fb * fb * (3 - 2 * fb)
    low = _lattice(ia, ib, key) * (1 - fa) + _lattice(ia + 1, ib, key) * fa
    high = _lattice(ia, ib + 1, key) * (1 - fa) + _lattice(ia + 1, ib + 1, key) * fa
    return np.asarray(low * (1 - fb) + high * fb)
