"""Kernels in two builds, and work shared between cores."""

from __future__ import annotations

import numba
import numpy as np
import pytest
import torch

from orca.conventions import Float64Array
from orca.threads import in_serial_mode, kernel, map_on_cores, single_threaded_torch


@kernel()
def _squares(first: int, end: int, x: Float64Array, out: Float64Array) -> None:
    """Squares."""
    for i in range(first, end):
        out[i] += x[i] * x[i]


@pytest.mark.parametrize("count", [0, 1, 2, 7, 8, 9, 100])
def test_a_kernel_does_each_item_once_alone_or_in_a_worker(count: int) -> None:
    x = np.arange(float(count))

    def run() -> Float64Array:
        out = np.zeros(count)
        _squares(count, x, out)
        return out

    for result in [run(), *map_on_cores(lambda _: run(), range(3))]:
        np.testing.assert_array_equal(result, x * x)
    assert _squares.__doc__ == "Squares."


@kernel()
def _division(first: int, end: int, x: Float64Array) -> None:
    for i in range(first, end):
        if x[i] == 0:
            raise ZeroDivisionError("no")


def test_an_error_in_a_kernel_reaches_the_caller() -> None:
    with pytest.raises(ZeroDivisionError):
        _division(10, np.zeros(10))


@pytest.mark.skipif(numba.get_num_threads() < 2, reason="one core: nothing is handed to workers")
def test_workers_are_serial_and_the_caller_is_not() -> None:
    assert not in_serial_mode()
    assert map_on_cores(lambda _: (in_serial_mode(), torch.get_num_threads()), range(4)) == [(True, 1)] * 4
    assert not in_serial_mode()


def test_order_is_kept_and_nesting_does_not_hang() -> None:
    nested = map_on_cores(lambda i: map_on_cores(lambda j: 10 * i + j, range(3)), range(4))
    assert nested == [[10 * i + j for j in range(3)] for i in range(4)]


def test_errors_reach_the_caller() -> None:
    with pytest.raises(ZeroDivisionError):
        map_on_cores(lambda i: 1 // i, [1, 0])


def test_torch_threads_come_back() -> None:
    before = torch.get_num_threads()

    def fail() -> None:
        with single_threaded_torch():
            assert torch.get_num_threads() == 1
            raise KeyError

    with pytest.raises(KeyError):
        fail()
    assert torch.get_num_threads() == before
