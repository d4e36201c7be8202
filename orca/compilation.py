"""Kernels are compiled on their first call after installation and cached: whoever waits is told so."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from numba.core import event

from orca.progress import Progress

__all__ = ["PHASE", "told_of_compilation"]

PHASE = "compiling kernels (first run only)"


class _Listener(event.Listener):  # type: ignore[misc]
    """Counts kernels as their compilation begins; what a kernel calls is compiled within it and not counted."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        self._depth = self._begun = 0

    def on_start(self, event: event.Event) -> None:
        if self._depth == 0:
            self._begun += 1
            self._progress(PHASE, self._begun, self._begun)
        self._depth += 1

    def on_end(self, event: event.Event) -> None:
        self._depth -= 1


@contextmanager
def told_of_compilation(progress: Progress) -> Iterator[None]:
    """Within the block, ``progress(PHASE, n, n)`` is called when the n-th kernel begins to be compiled.

    Nothing is called for kernels that come from numba's cache. numba compiles one kernel at a time, whatever the
    threads, so a count is enough.
    """
    with event.install_listener("numba:compile", _Listener(progress)):
        yield
