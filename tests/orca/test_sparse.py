"""The sparse product against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse
from hypothesis import given, settings
from hypothesis import strategies as st

from orca.stages.sparse import SparseMatrix


def random_matrix(rows: int, columns: int, density: float, seed: int) -> tuple[SparseMatrix, scipy.sparse.csr_matrix]:
    random = np.random.default_rng(seed)
    filled = random.random((rows, columns)) < density
    reference = scipy.sparse.csr_matrix(np.where(filled, random.normal(size=(rows, columns)), 0).astype(np.float32))
    ours = SparseMatrix.build(
        reference.indptr.astype(np.int64), reference.indices.astype(np.int32), reference.data, columns
    )
    return ours, reference


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 60), st.integers(1, 60), st.floats(0, 1), st.integers(1, 5), st.integers(0, 2**31))
def test_products_equal_scipys(rows: int, columns: int, density: float, k: int, seed: int) -> None:
    ours, reference = random_matrix(rows, columns, density, seed)
    random = np.random.default_rng(seed + 1)
    x = random.normal(size=(columns, k)).astype(np.float32)
    y = random.normal(size=(rows, k)).astype(np.float32)
    np.testing.assert_allclose(ours.times(x), reference @ x, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(ours.transposed_times(y), reference.T @ y, rtol=1e-4, atol=1e-4)
    assert ours.times(x).dtype == ours.transposed_times(y).dtype == np.float32


def test_by_hand() -> None:
    """[[0, 2, 0], [0, 0, 0], [1, 0, 3]]"""
    matrix = SparseMatrix.build(
        np.array([0, 1, 1, 3]), np.array([1, 0, 2], np.int32), np.array([2, 1, 3], np.float32), 3
    )
    x = np.array([[1], [10], [100]], np.float32)
    np.testing.assert_array_equal(matrix.times(x), [[20], [0], [301]])
    np.testing.assert_array_equal(matrix.transposed_times(x), [[100], [2], [300]])


@pytest.mark.parametrize("empty", ["rows", "entries"])
def test_nothing_times_something_is_nothing(empty: str) -> None:
    rows = 0 if empty == "rows" else 4
    none = SparseMatrix.build(np.zeros(rows + 1, np.int64), np.empty(0, np.int32), np.empty(0, np.float32), 3)
    assert none.times(np.ones((3, 2), np.float32)).tolist() == [[0.0, 0.0]] * rows
    assert none.transposed_times(np.ones((rows, 2), np.float32)).tolist() == [[0.0, 0.0]] * 3


def test_duplicate_entries_add_up() -> None:
    matrix = SparseMatrix.build(np.array([0, 2]), np.array([0, 0], np.int32), np.array([2, 3], np.float32), 1)
    assert matrix.times(np.ones((1, 1), np.float32)).item() == 5
    assert matrix.transposed_times(np.ones((1, 1), np.float32)).item() == 5
