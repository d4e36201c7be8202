"""How many anchors growth may place, which of them count, and which of the splits that it wants fit in."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from orca.config import GrowthConfig
from orca.conventions import Float64Array
from orca.errors import BadInput
from orca.stages.canvas import Canvas
from orca.stages.placement import Cells

__all__ = ["Allowance"]

_ADDED = 3  # cells by a split: four for one


@dataclass(frozen=True)
class Allowance:
    """How many cells there may be.

    Attributes:
        most: of those that count.
        margin: None if every cell counts; otherwise only those inside the original do, and there may be so many in
            the margin on top.
        low, high: corners of the original on the canvas, (x, y) in pixels.
    """

    most: int
    margin: int | None
    low: tuple[float, float]
    high: tuple[float, float]

    @staticmethod
    def of(canvas: Canvas, config: GrowthConfig) -> Allowance:
        """What a configuration allows on a canvas."""
        left, top, right, bottom = canvas.margins
        height, width = canvas.depth.shape
        corners = (left, top), (width - right, height - bottom)
        if config.max_inside is None:
            return Allowance(config.max_anchors or canvas.depth.size, None, *corners)
        return Allowance(config.max_inside, round(config.margin_share * config.max_inside), *corners)

    def at_least(self, cells: Cells) -> Allowance:
        """The same for a start that there cannot be less than.

        Raises `BadInput` if every cell counts and these are more than allowed.
        """
        count = self.count(cells)
        if self.margin is not None:
            return replace(self, most=max(self.most, count))
        if count > self.most:
            raise BadInput(
                f"at most {self.most} anchors", f"{count} or more for this picture and canvas", "allow more anchors"
            )
        return self

    @property
    def words(self) -> str:
        """Why growth stops when there are as many as allowed."""
        return f"reached {self.most} anchors" + ("" if self.margin is None else " inside the image")

    def count(self, cells: Cells) -> int:
        """How many of the cells count."""
        return len(cells.sizes) if self.margin is None else int(self._inside(cells.centres).sum())

    def full(self, cells: Cells) -> bool:
        """Whether there is no room for another split."""
        return self.most - self.count(cells) < _ADDED

    def chosen(self, cells: Cells, order: NDArray[np.int64], splits: int) -> NDArray[np.bool_]:
        """Which cells to split, [N]: as many as asked for, or as fit, of an order; at least the first.

        Args:
            cells: all cells.
            order: cells worth a split, the most worthy first.
            splits: how many to make; those in the margin come on top where the margin does not count.
        """
        chosen = np.zeros(len(cells.sizes), bool)
        count = self.count(cells)
        added = max(_ADDED, min(_ADDED * splits, self.most - count))
        adds = np.full(len(order), _ADDED) if self.margin is None else self._adds(cells, order)
        order = order[np.cumsum(adds) <= added]
        if self.margin is not None:
            beside = _ADDED - adds[: len(order)]
            fits = np.cumsum(beside) <= self.margin - (len(cells.sizes) - count)
            order = order[fits | (beside == 0)]
        chosen[order] = True
        return chosen

    def _inside(self, centres: Float64Array) -> NDArray[np.bool_]:
        return np.asarray(((centres >= self.low) & (centres < self.high)).all(-1))

    def _adds(self, cells: Cells, some: NDArray[np.int64]) -> NDArray[np.int64]:
        """How many cells that count splitting each of some cells adds, [n]: 0 to 3."""
        quarter = cells.sizes[some, None, None] / 4 * np.array([[-1, -1], [1, -1], [-1, 1], [1, 1]])
        after = self._inside(cells.centres[some, None] + quarter).sum(1)
        return np.asarray(after - self._inside(cells.centres[some]), np.int64)
