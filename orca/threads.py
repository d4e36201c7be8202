"""How the CPU's cores are shared between torch, numba and our own pools."""

from __future__ import annotations

import importlib
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import lru_cache
from typing import Any, Concatenate, Generic, ParamSpec, TypeVar

import numba
import torch
from threadpoolctl import ThreadpoolController

__all__ = [
    "Kernel",
    "in_serial_mode",
    "kernel",
    "map_on_cores",
    "multi_threaded_torch",
    "single_threaded_blas",
    "single_threaded_torch",
]

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")

_PIECES = 4  # of a range, a core: so that none waits long for another

_mode = threading.local()


class Kernel(Generic[P]):
    """A compiled loop over a range, its pieces shared between the cores.

    The function is ``f(first, end, *args)`` and writes what belongs to ``first`` to ``end`` (excluded) into arrays that
    it is given; the kernel is called with the length of the whole range in their place. It is compiled once, without
    numba's own threads: those double the time that compilation takes, and small work waits longer for them than it
    lasts.
    """

    def __init__(self, function: Callable[Concatenate[int, int, P], None], options: dict[str, Any]) -> None:
        self._compiled = numba.njit(nogil=True, cache=True, **options)(function)
        self.__doc__ = function.__doc__

    def __call__(self, count: int, *args: P.args, **kwargs: P.kwargs) -> None:
        """Run the loop from 0 to ``count``; inside a worker of `map_on_cores`, on that core alone."""
        workers = numba.get_num_threads()
        if in_serial_mode() or workers == 1 or count < 2:
            self._compiled(0, count, *args, **kwargs)
            return
        step = -(-count // min(count, _PIECES * workers))
        jobs = (
            _pool(workers).submit(self._compiled, first, min(count, first + step), *args, **kwargs)
            for first in range(0, count, step)
        )
        for job in list(jobs):
            job.result()


def kernel(**options: Any) -> Callable[[Callable[Concatenate[int, int, P], None]], Kernel[P]]:
    """Decorate the function of a `Kernel`; ``options`` go to `numba.njit`."""
    return lambda function: Kernel(function, options)


def in_serial_mode() -> bool:
    """Whether this thread is a worker of `map_on_cores`, one of several that share the cores already."""
    return getattr(_mode, "serial", False)


def map_on_cores(work: Callable[[T], R], items: Iterable[T]) -> list[R]:
    """``[work(item) for item in items]``, one item per core at a time; inside a worker, one after another."""
    if in_serial_mode() or numba.get_num_threads() == 1:
        return [work(item) for item in items]
    with single_threaded_torch(), single_threaded_blas():
        return list(_pool(numba.get_num_threads()).map(work, items))


@lru_cache(maxsize=4)
def _pool(workers: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(workers, initializer=_become_worker)


def _become_worker() -> None:
    _mode.serial = True
    torch.set_num_threads(1)


@lru_cache(maxsize=1)
def _blas() -> ThreadpoolController:
    """Control of the BLAS that numba's ``np.dot`` calls: scipy's, which must be loaded to be seen."""
    importlib.import_module("scipy.linalg.cython_blas")
    return ThreadpoolController()


@contextmanager
def single_threaded_blas() -> Iterator[None]:
    """Keep BLAS to the calling thread for a while: compiled code gives each core its own small products."""
    if in_serial_mode():  # a worker of `map_on_cores`, whose caller has seen to it
        yield
        return
    with _blas().limit(limits=1, user_api="blas"):
        yield


@contextmanager
def single_threaded_torch() -> Iterator[None]:
    """Keep torch to one thread for a while.

    torch's worker threads go on spinning after each small operation and take the core from numba's. Work that is
    worth all cores is given to them in pieces of our own instead.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@contextmanager
def multi_threaded_torch() -> Iterator[None]:
    """Give torch as many threads as numba has, for a large network inside work that keeps torch to one thread."""
    before = torch.get_num_threads()
    torch.set_num_threads(numba.get_num_threads())
    try:
        yield
    finally:
        torch.set_num_threads(before)
