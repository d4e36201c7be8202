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

    def scene_over(self, scene: str) -> None:
        """No process works on the scene any more."""
        ...

    def note(self, line: str) -> None:
        """Something a user should know, beside the progress."""
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

    def scene_over(self, scene: str) -> None:
        """Ignored."""

    def note(self, line: str) -> None:
        """Ignored."""

    def close(self) -> None:
        """Ignored."""


class BarReporter:
    """One tqdm bar over the cells with every worker's phase in its head, and a line for each finished cell; on stderr.

    Where stderr is no terminal there are only the lines.
    """

    def __init__(self) -> None:
        from tqdm import tqdm

        self._bar = tqdm(total=0, unit="cell", file=sys.stderr, dynamic_ncols=True, disable=None)
        self._write = tqdm.write
        self._drawn = 0.0
        self._at: dict[str, str] = {}  # scene that is being worked on -> where

    def start(self, cells: int) -> None:
        """Set the length of the bar."""
        self._bar.reset(total=cells)

    def phase(self, scene: str, method: str, phase: str, done: int, total: int) -> None:
        """Show scene, method and phase; a fit reports thousands of steps, the eye sees five a second."""
        now = time.monotonic()
        if 0 < done < total and now - self._drawn < 0.2:
            return
        self._drawn = now
        count = f" {done}/{total}" if total > 1 else ""
        self._at[scene] = f"{scene} · {method} · {phase}{count}"
        self._bar.set_description_str(" | ".join(self._at.values()))

    def cell(self, line: str | None) -> None:
        """Advance the bar and print the line above it."""
        if line is not None:
            self._write(line, file=sys.stderr)
        self._bar.update(1)

    def scene_over(self, scene: str) -> None:
        """Take the scene out of the head."""
        self._at.pop(scene, None)

    def note(self, line: str) -> None:
        """Print the line above the bar."""
        self._write(line, file=sys.stderr)

    def close(self) -> None:
        """Leave the last state of the bar standing."""
        self._bar.close()
