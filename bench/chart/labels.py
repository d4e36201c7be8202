"""Where names stand beside their points, so that no two overlap. All lengths are in pixels."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

__all__ = ["Box", "overlap", "place_labels"]

Box = tuple[float, float, float, float]  # left, bottom, right, top

# Right, left, above, below, then the diagonals: the order in which a reader would look.
_ANGLES = tuple(math.radians(a) for a in (0, 180, 90, 270, 45, 135, 315, 225, 20, 160, 340, 200, 65, 115, 245, 295))
_STEPS = (1.0, 1.6, 2.4, 3.4, 4.6, 6.0, 7.6, 9.4, 11.4)
_GAP = 1.5


def overlap(a: Box, b: Box) -> float:
    """Area that two boxes share."""
    width = min(a[2], b[2]) - max(a[0], b[0])
    height = min(a[3], b[3]) - max(a[1], b[1])
    return max(0.0, width) * max(0.0, height)


def place_labels(
    points: Sequence[tuple[float, float]],
    sizes: Sequence[tuple[float, float]],
    bounds: Box,
    obstacles: Sequence[Box] = (),
    lines: Sequence[Box] = (),
    reach: float = 9.0,
) -> list[Box]:
    """A box for each label near its point.

    Points in the densest company are served first. Each takes the first place that covers no other name, marker or
    obstacle and as little as can be had of lines, nearest rings first.

    Args:
        points: centres of the markers.
        sizes: width and height of each label.
        bounds: what no label may leave.
        obstacles: what is already there; the markers are added.
        lines: thin boxes of lines, which a name may cross if it must.
        reach: distance of the first ring from a point's centre.
    """
    markers = [(x - reach / 2, y - reach / 2, x + reach / 2, y + reach / 2) for x, y in points]
    placed: dict[int, Box] = {}
    for i in sorted(range(len(points)), key=lambda i: (-_company(points, i), i)):
        others = [box for j, box in enumerate(markers) if j != i]
        taken = [*placed.values(), *others, *obstacles]
        candidates = [box for box in _candidates(points[i], sizes[i], reach) if _inside(box, bounds)]
        ranked = [(*_covered(box, taken, lines), k) for k, box in enumerate(candidates)]
        placed[i] = candidates[min(ranked)[-1]] if ranked else _clamped(points[i], sizes[i], bounds)
    return [placed[i] for i in range(len(points))]


def _covered(box: Box, taken: Sequence[Box], lines: Sequence[Box]) -> tuple[float, float]:
    """Area that a name would take from what must be free, and from lines."""
    grown = _grown(box)
    return sum(overlap(grown, other) for other in taken), sum(overlap(grown, line) for line in lines)


def _company(points: Sequence[tuple[float, float]], i: int) -> float:
    """How crowded it is around a point."""
    return sum(1 / (1 + math.hypot(x - points[i][0], y - points[i][1])) for k, (x, y) in enumerate(points) if k != i)


def _candidates(point: tuple[float, float], size: tuple[float, float], reach: float) -> Iterator[Box]:
    """Boxes whose nearest edge or corner lies on a ring around the point."""
    (x, y), (width, height) = point, size
    for step in _STEPS:
        for angle in _ANGLES:
            cos, sin = math.cos(angle), math.sin(angle)
            centre_x = x + cos * (reach * step + width / 2)
            centre_y = y + sin * (reach * step + height / 2)
            yield centre_x - width / 2, centre_y - height / 2, centre_x + width / 2, centre_y + height / 2


def _inside(box: Box, bounds: Box) -> bool:
    return box[0] >= bounds[0] and box[1] >= bounds[1] and box[2] <= bounds[2] and box[3] <= bounds[3]


def _grown(box: Box) -> Box:
    return box[0] - _GAP, box[1] - _GAP, box[2] + _GAP, box[3] + _GAP


def _clamped(point: tuple[float, float], size: tuple[float, float], bounds: Box) -> Box:
    """Over the point, inside the bounds as far as it fits; for labels wider than the panel."""
    left = max(bounds[0], min(point[0] - size[0] / 2, bounds[2] - size[0]))
    bottom = max(bounds[1], min(point[1] - size[1] / 2, bounds[3] - size[1]))
    return left, bottom, left + size[0], bottom + size[1]
