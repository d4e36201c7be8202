"""How much memory there is for new work: Linux only, None elsewhere."""

from __future__ import annotations

from pathlib import Path

__all__ = ["available_gib"]

# Control groups, version 2 and version 1: the limit, what counts against it, and how much of that can be dropped.
_GROUPS = (
    ("sys/fs/cgroup", "memory.max", "memory.current", "inactive_file"),
    ("sys/fs/cgroup/memory", "memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
)


def available_gib(root: Path = Path("/")) -> float | None:
    """Memory that new work could take without swapping: the machine's, or the container's if that has less.

    Args:
        root: of the file system; for tests.
    """
    found = [_meminfo(root / "proc/meminfo"), *(_group(root, *files) for files in _GROUPS)]
    return min((gib for gib in found if gib is not None), default=None)


def _meminfo(path: Path) -> float | None:
    return _kib(path.read_text(), "MemAvailable:") if path.is_file() else None


def _kib(text: str, name: str) -> float | None:
    line = next((line for line in text.splitlines() if line.startswith(name)), None)
    return None if line is None else int(line.split()[1]) / 2**20


def _group(root: Path, folder: str, limit: str, used: str, droppable: str) -> float | None:
    place = root / folder
    if not all((place / name).is_file() for name in (limit, used, "memory.stat")):
        return None
    most, now = ((place / name).read_text().strip() for name in (limit, used))
    if most == "max":
        return None
    stat = dict(line.split(maxsplit=1) for line in (place / "memory.stat").read_text().splitlines())
    return max(0, int(most) - int(now) + int(stat.get(droppable, 0))) / 2**30
