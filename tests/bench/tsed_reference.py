"""Slow, obvious oracles of the TSED parts: other derivations, plain loops, float64."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from orca.camera import Camera

Array = NDArray[np.float64]


def _pixel_of(camera: Camera, point: Array) -> Array:
    local = camera.world_to_camera @ np.append(point, 1.0)
    u, v, w = camera.K @ local[:3]
    return np.array([u / w, v / w])


def _point_at(camera: Camera, pixel: Array, depth: float) -> Array:
    local = depth * (np.linalg.inv(camera.K) @ np.append(pixel, 1.0))
    return (np.linalg.inv(camera.world_to_camera) @ np.append(local, 1.0))[:3]


def _distance_to_line(pixel: Array, a: Array, b: Array) -> float:
    """Distance of a pixel from the line through a and b, by the area of the triangle."""
    return abs((b[0] - a[0]) * (a[1] - pixel[1]) - (a[0] - pixel[0]) * (b[1] - a[1])) / math.dist(a, b)


def sed_by_projection(first: Camera, second: Camera, x1: Array, x2: Array) -> Array:
    """Symmetric epipolar distance without a fundamental matrix.

    The epipolar line is drawn through the images of two points of the viewing ray.
    """
    distances = []
    for p, q in zip(x1, x2):
        there = [_pixel_of(second, _point_at(first, p, depth)) for depth in (2.0, 5.0)]
        back = [_pixel_of(first, _point_at(second, q, depth)) for depth in (2.0, 5.0)]
        distances.append(0.5 * (_distance_to_line(q, *there) + _distance_to_line(p, *back)))
    return np.array(distances)


def slow_matches(
    a: NDArray[np.float32], b: NDArray[np.float32], ratio: float, max_angle: float
) -> set[tuple[int, int]]:
    """Mutual nearest neighbours by angle with the ratio test in both directions: every angle, in a double loop."""
    angle = [[math.acos(min(1.0, max(-1.0, float(np.dot(p, q))))) for q in b.astype(float)] for p in a.astype(float)]

    def one_way(table: list[list[float]]) -> dict[int, int]:
        found = {}
        for i, row in enumerate(table):
            order = sorted(range(len(row)), key=row.__getitem__)
            second = row[order[1]] if len(row) > 1 else math.pi / 2
            if row[order[0]] <= max_angle and row[order[0]] < ratio * second:
                found[i] = order[0]
        return found

    forward = one_way(angle)
    backward = one_way([list(column) for column in zip(*angle)])
    return {(i, j) for i, j in forward.items() if backward.get(j) == i}
