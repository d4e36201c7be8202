"""Layered scenes of textured planes and boxes, cast exactly: colour, z-depth, and what the input view hid.

Everything is closed form: a plane or a box is intersected with each ray in float64, so depth and visibility carry no
error of a mesh or a raster. Colours are view-independent (texture times a constant per face).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.datasets.synthetic_textures import Texture, random_texture
from orca.camera import Camera
from orca.conventions import Float32Array, Float64Array, UInt8Array, pixel_grid, to_uint8

__all__ = ["Box", "Hidden", "Plane", "Surfaces", "hidden_from", "random_scene", "render_colour", "render_depth"]

_SAME_POINT = 1e-6
"""Relative difference of two depths along one ray below which they are one point."""

_SHADES = (0.7, 0.85, 1.0)  # of a box's faces, by the axis that they face


@dataclass(frozen=True, eq=False)
class Plane:
    """An infinite plane: ``normal . X = offset``; u and v run along ``axes`` [2, 3]."""

    normal: Float64Array
    offset: float
    axes: Float64Array
    texture: Texture

    def hit(self, origin: Float64Array, rays: Float64Array) -> Float64Array:
        """Ray parameter of the hit, infinite where there is none, [n]."""
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (self.offset - self.normal @ origin) / (rays @ self.normal)
        return np.where(t > 0, t, np.inf)

    def colours(self, points: Float64Array) -> Float64Array:
        """Colours at points on it, [n, 3]."""
        u, v = self.axes @ points.T
        return self.texture.colours(u, v)


@dataclass(frozen=True, eq=False)
class Box:
    """An oriented box: columns of ``rotation`` are its axes, ``half`` its half sizes."""

    centre: Float64Array
    half: Float64Array
    rotation: Float64Array
    texture: Texture

    def hit(self, origin: Float64Array, rays: Float64Array) -> Float64Array:
        """Ray parameter where a ray enters, infinite where it misses, [n]. Slab test (Kay and Kajiya 1986)."""
        enter, leave = np.full(len(rays), -np.inf), np.full(len(rays), np.inf)
        for axis, half in zip(self.rotation.T, self.half, strict=True):
            o = (origin - self.centre) @ axis
            with np.errstate(divide="ignore", invalid="ignore"):
                inverse = 1.0 / (rays @ axis)
                one, two = (-half - o) * inverse, (half - o) * inverse
            enter, leave = np.maximum(enter, np.minimum(one, two)), np.minimum(leave, np.maximum(one, two))
        return np.where((enter > 0) & (enter <= leave), enter, np.inf)

    def colours(self, points: Float64Array) -> Float64Array:
        """Colours at points on it, [n, 3]; each pair of faces has its own shade."""
        local = (points - self.centre) @ self.rotation
        axis = np.argmax(np.abs(local) / self.half, axis=1)
        rows = np.arange(len(local))
        u, v = local[rows, (axis + 1) % 3], local[rows, (axis + 2) % 3]
        return np.asarray(self.texture.colours(u, v) * np.array(_SHADES)[axis][:, None])


Surfaces = Sequence[Plane | Box]


@dataclass(frozen=True, eq=False)
class Hidden:
    """What a view shows that the input view does not.

    Attributes:
        occluded: pixels whose point lies in the input's frame but behind something, [H, W] bool.
        outside: pixels whose point lies outside the input's frame, [H, W] bool.
        occluder_depth: z-depth, in this view, of the point that hid an occluded pixel's point from the input; NaN
            where nothing did, or where a surface hid itself (the side of a box), [H, W] float32.
    """

    occluded: NDArray[np.bool_]
    outside: NDArray[np.bool_]
    occluder_depth: Float32Array


def random_scene(seed: int, kinds: Sequence[str]) -> Surfaces:
    """A wall, a tilted floor, two or three boxes and one or two poles.

    Args:
        seed: of the geometry and of the textures. The geometry does not depend on ``kinds``.
        kinds: textures of wall and floor are drawn from these.
    """
    shape, look = np.random.default_rng([seed, 0]), np.random.default_rng([seed, 1])
    wall = _plane([np.sin(a := shape.uniform(-0.3, 0.3)), 0.0, np.cos(a)], [0, 0, shape.uniform(2.7, 3.3)], look, kinds)
    tilt, roll = shape.uniform(0.0, 0.12), shape.uniform(-0.08, 0.08)
    floor = _plane([roll, 1.0, tilt], [0.0, shape.uniform(0.6, 0.8), 1.0], look, kinds)
    surfaces: list[Plane | Box] = [wall, floor]
    for _ in range(int(shape.integers(2, 4))):
        half = shape.uniform([0.12, 0.25, 0.02], [0.3, 0.5, 0.12])
        surfaces.append(_standing_box(half, floor, shape, look))
    for _ in range(int(shape.integers(1, 3))):
        width = shape.uniform(0.012, 0.025)
        surfaces.append(_standing_box(np.array([width, shape.uniform(0.5, 0.8), width]), floor, shape, look))
    return surfaces


def _plane(normal: Sequence[float], point: Sequence[float], look: np.random.Generator, kinds: Sequence[str]) -> Plane:
    n = np.asarray(normal, np.float64)
    n /= np.linalg.norm(n)
    first = np.cross(n, [0.0, 0.0, 1.0] if abs(n[2]) < 0.9 else [0.0, 1.0, 0.0])
    first /= np.linalg.norm(first)
    kind = str(look.choice(list(kinds)))
    return Plane(n, float(n @ np.asarray(point)), np.stack([first, np.cross(n, first)]), random_texture(kind, look))


def _standing_box(half: Float64Array, floor: Plane, shape: np.random.Generator, look: np.random.Generator) -> Box:
    """A box on the floor, turned about the vertical, clear of the left and right border of a view of 60 degrees.

    What a view uncovers is then hidden by something inside the frame: a question of repair and not of outpainting.
    """
    z = shape.uniform(1.2, 2.1)
    reach = 0.45 - (half[0] + half[2]) / z
    x = z * reach * shape.uniform(-1.0, 1.0)
    y = (floor.offset - floor.normal[0] * x - floor.normal[2] * z) / floor.normal[1]
    a = shape.uniform(-0.5, 0.5)
    rotation = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    kind = str(look.choice(["gradient", "stripes", "noise"]))
    return Box(np.array([x, y - half[1], z]), half, rotation, random_texture(kind, look))


def _cast(surfaces: Surfaces, origin: Float64Array, rays: Float64Array) -> tuple[Float64Array, NDArray[np.intp]]:
    """Ray parameter and index of the first surface that each ray meets, [n] each."""
    nearest, first = np.full(len(rays), np.inf), np.zeros(len(rays), np.intp)
    for index, surface in enumerate(surfaces):
        t = surface.hit(origin, rays)
        nearer = t < nearest
        nearest[nearer], first[nearer] = t[nearer], index
    return nearest, first


def render_depth(surfaces: Surfaces, camera: Camera) -> Float32Array:
    """z-depth at the pixel centres, [H, W]; infinite where nothing is."""
    t, _ = _cast(surfaces, camera.center, camera.rays())
    return t.reshape(camera.height, camera.width).astype(np.float32)


def render_colour(surfaces: Surfaces, camera: Camera, samples: int = 2) -> UInt8Array:
    """Colours, the mean of ``samples`` x ``samples`` rays a pixel, [H, W, 3] uint8."""
    total = np.zeros((camera.height * camera.width, 3))
    centres = pixel_grid(camera.width, camera.height)
    for k in range(samples**2):
        offset = (np.array([k % samples, k // samples]) + 0.5) / samples - 0.5
        rays = camera.rays(centres + offset)
        t, seen = _cast(surfaces, camera.center, rays)
        for index, surface in enumerate(surfaces):
            mine = np.flatnonzero((seen == index) & np.isfinite(t))
            total[mine] += surface.colours(camera.center + t[mine, None] * rays[mine])
    return to_uint8((total / samples**2).reshape(camera.height, camera.width, 3).astype(np.float32))


def hidden_from(surfaces: Surfaces, source: Camera, view: Camera) -> Hidden:
    """Which pixels of ``view`` show what ``source`` does not see, by casting a ray from the source to each point."""
    rays = view.rays()
    t, mine = _cast(surfaces, view.center, rays)
    points = view.center + np.where(np.isfinite(t), t, 1.0)[:, None] * rays
    pixels, z = source.project(points)
    inside = np.isfinite(t) & (z > 0) & (pixels >= 0).all(1) & (pixels <= [source.width, source.height]).all(1)
    to_point = points - source.center
    reached, blocker = _cast(surfaces, source.center, to_point)
    occluded = inside & (reached < 1.0 - _SAME_POINT)
    _, blocker_z = view.project(source.center + np.where(occluded, reached, 1.0)[:, None] * to_point)
    depth = np.where(occluded & (blocker != mine), blocker_z, np.nan)
    shape = (view.height, view.width)
    return Hidden(occluded.reshape(shape), ~inside.reshape(shape), depth.reshape(shape).astype(np.float32))
