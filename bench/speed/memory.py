"""Peak memory of one case: the largest resident set of a fresh process that does nothing else.

It counts all of the process: interpreter, torch and numba with the pages of their libraries (about 0.6 GB before any
work), the scene, and one execution of the case. Compiled kernels are read from numba's cache, which the timing before
has filled. ``getrusage`` is not asked where the kernel keeps a better figure: on Linux its peak is inherited from the
parent of a process.
"""

from __future__ import annotations

import logging
import multiprocessing
import sys
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

from bench.processes import memory_mb
from bench.speed.case import Backend, Setting

__all__ = ["own_peak_mb", "peak_mb"]

_log = logging.getLogger(__name__)


def peak_mb(setting: Setting, backend: Backend, folder: Path, base_width: int) -> float | None:
    """Peak resident memory in MB (10^6 bytes) of one execution; None if the process was killed.

    Args:
        setting: what to run, as large and with as many threads as it was timed.
        backend: by whom.
        folder: of the workshop: the scene is read from there.
        base_width: of the workshop.
    """
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        try:
            return pool.submit(_run_once, setting, backend, folder, base_width).result()
        except BrokenProcessPool:
            _log.warning("the process that measures the memory of %s/%s was killed", setting.case, backend)
            return None


def _run_once(setting: Setting, backend: Backend, folder: Path, base_width: int) -> float | None:
    logging.disable(logging.WARNING)  # the parent has said it
    from bench.speed.threads import limited_to
    from bench.speed.works import build_work
    from bench.speed.workshop import Workshop

    with limited_to(setting.threads):
        build_work(setting, backend, Workshop(folder, base_width))(0)
    return own_peak_mb()


def own_peak_mb() -> float | None:
    """Peak resident set of this process so far, MB; None where the system does not say."""
    peak = memory_mb("VmHWM")
    if peak is not None:
        return peak
    try:
        import resource
    except ImportError:  # not a POSIX system
        return None
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6
