"""Progress bars on the error stream: one per phase of the work."""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import TracebackType
from typing import Any

__all__ = ["PhaseBars", "Progress"]

Progress = Callable[[str, int, int], None]  # called as progress(phase, done, total)


class PhaseBars:
    """Call it as progress(phase, done, total); a context manager, so that the last bar is closed on an error too."""

    def __init__(self) -> None:
        self._phase: str | None = None
        self._bar: Any = None

    def __call__(self, phase: str, done: int, total: int) -> None:
        """Move the bar of ``phase`` to ``done`` of ``total``; another phase than before starts another bar."""
        from tqdm import tqdm

        if phase != self._phase:
            self.close()
            every = 0.1 if sys.stderr.isatty() else 10.0  # a log file needs no ten redraws a second
            self._bar = tqdm(total=total, desc=phase, file=sys.stderr, dynamic_ncols=True, mininterval=every)
            self._phase = phase
        if self._bar.total != total:
            self._bar.total = total
        self._bar.update(done - self._bar.n)

    def close(self) -> None:
        """End the current bar, if there is one."""
        if self._bar is not None:
            self._bar.close()
        self._phase = self._bar = None

    def __enter__(self) -> PhaseBars:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self.close()
