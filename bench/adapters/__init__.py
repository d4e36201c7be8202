"""Methods: every way in which frames come in, behind one protocol."""

from bench.adapters.adapter import Adapter, MethodOutput, RunOptions
from bench.adapters.external import MethodRegistry, open_methods

__all__ = ["METHODS", "Adapter", "MethodOutput", "RunOptions", "open_methods"]

METHODS: MethodRegistry[Adapter] = MethodRegistry(
    "method",
    {
        "orca": "bench.adapters.orca:ORCA",
        "orca-paper": "bench.adapters.orca:ORCA_PAPER",
        "orca-norepair": "bench.adapters.orca:ORCA_NO_REPAIR",
        "orca-plainfill": "bench.adapters.orca:ORCA_PLAIN_FILL",
        "vistadream": "bench.adapters.vistadream:VISTADREAM",
        "vistadream-coarse": "bench.adapters.vistadream:VISTADREAM_COARSE",
        "warp": "bench.adapters.warp:WARP",
        "warp-telea": "bench.adapters.warp:WARP_TELEA",
        "warp-nearest": "bench.adapters.warp:WARP_NEAREST",
    },
)
