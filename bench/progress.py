"""What a run tells while it works: bars and lines on the error stream, or nothing."""

from __future__ import annotations

import sys
import time
from typing import Protocol

__all__ = ["BarReporter", "Reporter", "SilentReporter"]


class Reporter(Protocol):
    """Hears what a run is doing."""

    def start(self, cells: int) -> None:
        """A run over this many (method, scene) cells begins."""
        ...

    def phase(self, scene: str, method: str, phase: str, done: int, total: int) -> None:
        """Work inside a cell moved on."""
        ...

    def cell(self, line: str | None) -> None:
        """A cell is over; ``line`` says how it went, or is None for one that was finished before."""
        ...

    def close(self) -> None:
        """The run is over, or was interrupted."""
        ...


class SilentReporter:
    """Tells nothing; for tests and for use as a library."""

    def start(self, cells: int) -> None:
        """Ignored."""

    def phase(self, scene: str, method: str, phase: str, done: int, total: int) -> None:
        """Ignored."""

    def cell(self, line: str | None) -> None:
        """Ignored."""

    def close(self) -> None:
        """Ignored."""


class BarReporter:
    """One tqdm bar over the cells, with the phase in its tail, and one line per finished cell; all on stderr."""

    def __init__(self) -> None:
        from tqdm import tqdm

        # A log file gets a line every half minute instead of ten redraws a second.
        self._interactive = sys.stderr.isatty()
        self._every = 0.2 if self._interactive else 30.0
        self._bar = tqdm(
            total=0, unit="cell", file=sys.stderr, mininterval=self._every, dynamic_ncols=True, disable=None
        )
        self._tqdm = tqdm
        self._last = 0.0

    def start(self, cells: int) -> None:
        """Set the length of the bar."""
        self._bar.reset(total=cells)

    def phase(self, scene: str, method: str, phase: str, done: int, total: int) -> None:
        """Show scene, method and phase; redraw no more often than the eye, or the log, wants it."""
        now = time.monotonic()
        if now - self._last < self._every and 0 < done < total:
            return
        self._last = now
        count = f" {done}/{total}" if total > 1 else ""
        if self._interactive:
            self._bar.set_description_str(f"{scene} · {method} · {phase}{count}")

    def cell(self, line: str | None) -> None:
        """Advance the bar and print the line above it."""
        if line is not None:
            self._tqdm.write(line, file=sys.stderr)
        self._bar.update(1)

    def close(self) -> None:
        """Leave the last state of the bar standing."""
        self._bar.close()
