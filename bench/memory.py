"""How much memory a method needs, measured inside the process that it shares with others.

The peak that ``getrusage`` gives never falls within a process, so it would charge a method with what an earlier one
took. On Linux the kernel's high-water mark can be set back; elsewhere nothing is measured, and nothing is guessed.

The mark counts the whole process, what earlier methods left resident included, and so does what was resident at the
start. Their difference is what the method added; a method that is the first to load torch is charged with it. Memory
of a GPU is not counted.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
from collections.abc import Iterator
from pathlib import Path

from bench.processes import memory_mb

__all__ = ["PeakMemory", "peak_memory"]

_CLEAR = Path("/proc/self/clear_refs")
_RESET_PEAK = "5"  # proc(5): resets the peak resident set size


class PeakMemory:
    """Filled when the block of `peak_memory` is over.

    Attributes:
        before_mb: resident when the block began, MB of 1e6 bytes; None where that cannot be known.
        peak_mb: the most that was resident during the block.
    """

    before_mb: float | None = None
    peak_mb: float | None = None

    def to_json(self) -> dict[str, float | None]:
        """Both numbers, to a tenth of a MB."""
        numbers = {"before_mb": self.before_mb, "peak_mb": self.peak_mb}
        return {name: None if value is None else round(value, 1) for name, value in numbers.items()}


@contextlib.contextmanager
def peak_memory() -> Iterator[PeakMemory]:
    """Measure a block. Blocks must not overlap, in threads or nested: the inner one would set the outer one's mark."""
    measured = PeakMemory()
    if _reset():
        measured.before_mb = memory_mb()
    try:
        yield measured
    finally:
        if measured.before_mb is not None:
            measured.peak_mb = memory_mb("VmHWM")


def _reset() -> bool:
    """Give free memory back to the system and set the mark to what is left; False where that cannot be done."""
    gc.collect()
    with contextlib.suppress(OSError, AttributeError, TypeError):  # not glibc: what is free counts as there before
        ctypes.CDLL(None).malloc_trim(0)
    try:
        _CLEAR.write_text(_RESET_PEAK)
    except OSError:  # not Linux, or not allowed
        return False
    return memory_mb("VmHWM") is not None
