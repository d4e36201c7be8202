"""A constant sparse matrix times a few columns, forwards and transposed, on all cores (scipy uses one)."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from orca.conventions import Float32Array
from orca.threads import kernel

__all__ = ["SparseMatrix"]


@dataclass(frozen=True, eq=False)
class SparseMatrix:
    """Compressed rows, and the compressed rows of the transpose.

    Attributes:
        rows: (indptr, indices, values) of the matrix [R, C].
        columns: the same of its transpose [C, R].
    """

    rows: tuple[NDArray[np.int64], NDArray[np.int32], Float32Array]
    columns: tuple[NDArray[np.int64], NDArray[np.int32], Float32Array]

    @staticmethod
    def build(indptr: NDArray[np.int64], indices: NDArray[np.int32], values: Float32Array, width: int) -> SparseMatrix:
        """From compressed rows; ``width`` is the number of columns C."""
        return SparseMatrix((indptr, indices, values), _transpose(indptr, indices, values, width))

    def times(self, x: Float32Array) -> Float32Array:
        """Matrix [R, C] times x [C, k]."""
        return _product(*self.rows, x)

    def transposed_times(self, y: Float32Array) -> Float32Array:
        """Transpose [C, R] times y [R, k]."""
        return _product(*self.columns, y)


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _transpose(
    indptr: NDArray[np.int64], indices: NDArray[np.int32], values: Float32Array, width: int
) -> tuple[NDArray[np.int64], NDArray[np.int32], Float32Array]:
    offset = np.zeros(width + 1, np.int64)
    for i in indices:
        offset[i + 1] += 1
    for c in range(width):
        offset[c + 1] += offset[c]
    cursor = offset[:-1].copy()
    row, value = np.empty(len(indices), np.int32), np.empty(len(indices), np.float32)
    for r in range(len(indptr) - 1):
        for k in range(indptr[r], indptr[r + 1]):
            at = cursor[indices[k]]
            row[at], value[at] = r, values[k]
            cursor[indices[k]] = at + 1
    return offset, row, value


def _product(
    indptr: NDArray[np.int64], indices: NDArray[np.int32], values: Float32Array, x: Float32Array
) -> Float32Array:
    out = np.zeros((len(indptr) - 1, x.shape[1]), np.float32)
    _add_products(len(out), indptr, indices, values, x, out)
    return out


@kernel()
def _add_products(
    first: int,
    end: int,
    indptr: NDArray[np.int64],
    indices: NDArray[np.int32],
    values: Float32Array,
    x: Float32Array,
    out: Float32Array,
) -> None:
    for r in range(first, end):
        for k in range(indptr[r], indptr[r + 1]):
            for c in range(x.shape[1]):
                out[r, c] += values[k] * x[indices[k], c]
