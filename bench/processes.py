"""Processes of this machine: the memory that one holds, and children that do not outlive their parent."""

from __future__ import annotations

import os
import threading
from multiprocessing import parent_process
from pathlib import Path

__all__ = ["end_with_parent", "memory_mb"]


def memory_mb(field: str = "VmRSS", process: int | None = None) -> float | None:
    """Memory of a process in MB (10^6 bytes); None where the system does not say, or the process is gone.

    Args:
        field: of ``/proc/PID/status``: "VmRSS" is what is resident, "VmHWM" the most that was.
        process: its number; this one if left out.
    """
    try:
        lines = Path(f"/proc/{process or 'self'}/status").read_text().splitlines()
    except OSError:
        return None
    line = next((line for line in lines if line.startswith(f"{field}:")), None)
    return None if line is None else int(line.split()[1]) * 1024 / 1e6


def end_with_parent() -> None:
    """From now on this child ends when its parent does: one that was killed has nobody left to end its children."""
    threading.Thread(target=_wait_for_parent, daemon=True).start()


def _wait_for_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
