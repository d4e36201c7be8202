"""How many threads a timing may use."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["available_threads", "limited_to"]


def available_threads() -> int:
    """The most threads that kernels can be given: the cores, or NUMBA_NUM_THREADS where that is set."""
    import numba

    return int(numba.config.NUMBA_NUM_THREADS)


@contextmanager
def limited_to(threads: int) -> Iterator[None]:
    """Give numba, torch and OpenCV that many threads for a while.

    The BLAS inside numpy keeps its own: it multiplies 3x3 matrices here. A row whose CPU time is more than its threads
    times its wall time would show it.
    """
    import cv2
    import numba
    import torch

    before = numba.get_num_threads(), torch.get_num_threads(), cv2.getNumThreads()
    numba.set_num_threads(threads)
    torch.set_num_threads(threads)
    cv2.setNumThreads(threads)
    try:
        yield
    finally:
        numba.set_num_threads(before[0])
        torch.set_num_threads(before[1])
        cv2.setNumThreads(before[2])
