"""Rows of an array that grows at its end, at the cost of what is appended."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["SharedRows"]


class SharedRows:
    """Memory of which arrays of several lengths share the beginning.

    Args:
        rows: the first array, [N, ...]; never written to.
    """

    def __init__(self, rows: NDArray[Any]) -> None:
        self._memory, self._used = rows, len(rows)

    def extended(self, count: int, more: NDArray[Any]) -> tuple[SharedRows, NDArray[Any]]:
        """The first ``count`` rows followed by ``more``, and the memory that they are in.

        That is this one, if nothing else follows those rows in it and there is room; else a larger one of their own.
        """
        total, rows = count + len(more), self
        if self._used != count or total > len(self._memory):
            memory = np.empty((total + total // 2, *self._memory.shape[1:]), self._memory.dtype)
            memory[:count] = self._memory[:count]
            rows = SharedRows(memory)
        rows._memory[count:total] = more
        rows._used = total
        return rows, rows._memory[:total]
