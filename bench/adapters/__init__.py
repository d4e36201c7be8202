"""Methods: every way in which frames come in, behind one protocol."""

from bench.adapters.adapter import Adapter, MethodOutput, RunOptions
from orca.registry import Registry

__all__ = ["METHODS", "Adapter", "MethodOutput", "RunOptions"]

METHODS: Registry[Adapter] = Registry(
    "method",
    {
        "orca": "bench.adapters.orca:ORCA",
        "orca-paper": "bench.adapters.orca:ORCA_PAPER",
        "vistadream": "bench.adapters.vistadream:VISTADREAM",
        "vistadream-coarse": "bench.adapters.vistadream:VISTADREAM_COARSE",
        "warp": "bench.adapters.warp:WARP",
        "warp-telea": "bench.adapters.warp:WARP_TELEA",
    },
)
