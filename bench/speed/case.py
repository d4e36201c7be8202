"""What is timed: the grid of settings, the quick part of it and the whole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Literal

from bench.speed.timing import Patience

__all__ = ["CASES", "Backend", "CaseName", "Mode", "Setting", "full_plan", "quick_plan"]

CaseName = Literal["frame", "fit", "step", "stage3"]
Backend = Literal["fast", "reference"]
Mode = Literal["layered", "per-hit"]

CASES: tuple[CaseName, ...] = ("frame", "fit", "step", "stage3")
BOTH: tuple[Backend, ...] = ("fast", "reference")
# The solver of the fit and the loop of repairs have no slow twin that could be timed: what they compute is held to
# other oracles, by tests.
BACKENDS: dict[CaseName, tuple[Backend, ...]] = {"frame": BOTH, "fit": ("fast",), "step": BOTH, "stage3": ("fast",)}

ANCHORS = (65_536, 262_144)
WIDTHS = (256, 512, 1024)
THREADS = (1, 2)
MODES: tuple[Mode, ...] = ("layered", "per-hit")
BASE_WIDTH = 512


@dataclass(frozen=True)
class Setting:
    """One thing to time, by one backend or by two in turns.

    Attributes:
        case: frame: one view from a camera not seen before; fit: stages 1 and 2 with the canvas; step: one gradient
            step of a batch of rays; stage3: repair along a short trajectory.
        mode: how hits are decoded.
        anchors: how many anchors are asked for; the rows say how many there were.
        width: side of the square image in pixels.
        threads: of numba, torch and OpenCV.
        backends: who is timed, in turns.
        patience: how often.
        measure_memory: whose peak memory is measured, in a process of its own each.
    """

    case: CaseName
    mode: Mode
    anchors: int
    width: int
    threads: int
    backends: tuple[Backend, ...]
    patience: Patience
    measure_memory: tuple[Backend, ...]


def full_plan(cases: Sequence[CaseName], threads: Sequence[int] = THREADS) -> tuple[Setting, ...]:
    """Every combination there is: 256 to 1024 pixels, both anchor counts, both modes; peak memory of every row.

    A fit has at most one anchor per pixel. A step is as large as its batch and a repair as its holes, so both are
    timed at 512 pixels only.
    """
    settings = []
    for case in cases:
        widths = WIDTHS if case in ("frame", "fit") else (BASE_WIDTH,)
        for mode, anchors, width, n in product(MODES, ANCHORS, widths, threads):
            if case == "fit" and anchors > width * width:
                continue
            backends = BACKENDS[case]
            settings.append(Setting(case, mode, anchors, width, n, backends, _patience(case), backends))
    return tuple(settings)


def quick_plan(cases: Sequence[CaseName], threads: int = THREADS[-1]) -> tuple[Setting, ...]:
    """Under a minute: each case at 65k anchors and 512 pixels, and what the two exponents of a frame need.

    The reference takes four seconds for a per-hit frame of 512 pixels, so it is compared at 256. A fit and a
    repair are timed once. Peak memory is left to the full plan: every process of its own takes seconds to start.
    """
    few, once = Patience(1, 3, 2, seconds=3.0), Patience(0, 1, 1, seconds=0.0)
    small, base = ANCHORS[0], BASE_WIDTH
    settings = {
        "frame": [
            Setting("frame", "layered", small, base, threads, BOTH, few, ()),
            Setting("frame", "layered", small, 256, threads, ("fast",), few, ()),
            Setting("frame", "layered", small, 1024, threads, ("fast",), few, ()),
            Setting("frame", "layered", ANCHORS[1], base, threads, ("fast",), few, ()),
            Setting("frame", "per-hit", small, base, threads, ("fast",), few, ()),
            Setting("frame", "per-hit", small, 256, threads, BOTH, few, ()),
        ],
        "fit": [Setting("fit", "layered", small, base, threads, BACKENDS["fit"], once, ())],
        "step": [Setting("step", "layered", small, base, threads, BOTH, few, ())],
        "stage3": [Setting("stage3", "layered", small, base, threads, BACKENDS["stage3"], once, ())],
    }
    return tuple(setting for case in cases for setting in settings[case])


def _patience(case: CaseName) -> Patience:
    if case in ("frame", "step"):
        return Patience(warmup=2, repeats=9, least=3, seconds=30.0)
    return Patience(warmup=1, repeats=5, least=3, seconds=40.0)
