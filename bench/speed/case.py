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

    Peak memory is measured once a case: a process of its own takes seconds to start.
    """
    few = Patience(warmup=1, repeats=3, least=2, seconds=6.0)
    settings = []
    for case in cases:
        backends = BACKENDS[case]
        settings.append(Setting(case, "layered", ANCHORS[0], BASE_WIDTH, threads, backends, few, ("fast",)))
        if case == "frame":
            settings.append(Setting(case, "per-hit", ANCHORS[0], BASE_WIDTH, threads, backends, few, ()))
            for anchors, width in ((ANCHORS[0], 256), (ANCHORS[0], 1024), (ANCHORS[1], BASE_WIDTH)):
                settings.append(Setting(case, "layered", anchors, width, threads, ("fast",), few, ()))
    return tuple(settings)


def _patience(case: CaseName) -> Patience:
    if case in ("frame", "step"):
        return Patience(warmup=2, repeats=9, least=3, seconds=30.0)
    return Patience(warmup=1, repeats=5, least=3, seconds=40.0)
