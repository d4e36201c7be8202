"""Facts about the machine that a timing, or a score, may depend on. Imports none of the libraries it names."""

from __future__ import annotations

import os
import platform
import sys
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

__all__ = ["host_facts", "package_versions", "usable_cores"]

_PACKAGES = ("orca-nvs", "torch", "torchvision", "numpy", "scipy", "numba", "pyiqa", "kornia", "open_clip_torch", "av")
_OPENCV = (
    "opencv-contrib-python-headless",
    "opencv-python-headless",
    "opencv-contrib-python",
    "opencv-python",
)


@cache
def package_versions() -> dict[str, str | None]:
    """Installed versions from the packages' metadata; None for a package that is not installed."""
    versions = {name: _version(name) for name in _PACKAGES}
    versions["opencv"] = next((found for name in _OPENCV if (found := _version(name))), None)
    return versions


def host_facts(device: str = "cpu") -> dict[str, Any]:
    """Processor, cores, threads, memory, platform, Python and library versions, JSON-ready.

    ``threads`` is what torch uses if it is loaded, else what OMP_NUM_THREADS says, else the cores this process may use.
    """
    return {
        "cpu": _cpu_model(),
        "cores": usable_cores(),
        "threads": _threads(),
        "memory_gib": _memory_gib(),
        "device": device,
        "platform": platform.platform(),
        "python": platform.python_version(),
        "versions": dict(package_versions()),
    }


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _cpu_model() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        for line in cpuinfo.read_text(errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def usable_cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _threads() -> int:
    torch = sys.modules.get("torch")
    if torch is not None:
        return int(torch.get_num_threads())
    wanted = os.environ.get("OMP_NUM_THREADS", "")
    return int(wanted) if wanted.isdigit() and int(wanted) > 0 else usable_cores()


def _memory_gib() -> float | None:
    try:
        return round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1)
    except (ValueError, OSError, AttributeError):  # not a POSIX system
        return None
