"""What is known of methods that are not run here, each row with its source."""

from __future__ import annotations

from typing import Any

from bench.stability.outcome import CRASH

__all__ = ["KNOWN_ROWS"]

_VISTADREAM = (
    "IndexError: VistaDream's published code takes np.percentile(depth[~sky], 95), and without a pixel that is not sky "
    "that array is empty (github.com/WHU-USI3DV/VistaDream, commit b4b437d, ops/legos/inpaints/sky.py, "
    "Sky_Tool._set_sky_depth_); read in its code, not run here"
)

KNOWN_ROWS: tuple[dict[str, Any], ...] = (
    {
        "case": "all-sky",
        "group": "image",
        "method": "vistadream",
        "outcome": CRASH,
        "expected": [],
        "as_expected": None,
        "detail": _VISTADREAM,
        "seconds": None,
        "measured": False,
    },
)
