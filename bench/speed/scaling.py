"""How time grows: the exponent of time against pixels and against anchors."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from bench.speed.measure import SpeedRow

__all__ = ["Exponent", "scaling_exponents"]


@dataclass(frozen=True)
class Exponent:
    """Least-squares slope of log(wall time) over log(size).

    Attributes:
        along: "pixels" (rows of several widths, one anchor count) or "anchors" (the other way round).
        case, backend, mode, threads: what was timed.
        fixed: the anchor count, or the width, that all rows share.
        sizes: the pixels or anchors, ascending.
        value: the exponent; 1 is proportional.
    """

    along: Literal["pixels", "anchors"]
    case: str
    backend: str
    mode: str
    threads: int
    fixed: int
    sizes: tuple[int, ...]
    value: float

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self)


def scaling_exponents(rows: Sequence[SpeedRow]) -> list[Exponent]:
    """The exponents of every group of rows that differ in one size alone."""
    groups: dict[tuple[Any, ...], list[tuple[int, float]]] = defaultdict(list)
    for row in rows:
        what = (row.case, row.backend, row.mode, row.threads)
        groups["pixels", *what, row.anchors].append((row.width**2, row.wall_ms))
        groups["anchors", *what, row.width].append((int(row.facts.get("anchors") or row.anchors), row.wall_ms))
    out = []
    for (along, case, backend, mode, threads, fixed), points in groups.items():
        points.sort()
        sizes, times = (np.array(column, float) for column in zip(*points, strict=True))
        if len(set(sizes)) > 1:
            slope = float(np.polyfit(np.log(sizes), np.log(times), 1)[0])
            out.append(Exponent(along, case, backend, mode, threads, fixed, tuple(int(s) for s in sizes), slope))
    return out
