"""Cases that are photographs: those dominated by sky, on which the paper lost a scene."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from bench.datasets import open_dataset
from bench.datasets.case import SceneCase
from bench.stability.case import StabilityCase
from bench.stability.outcome import FINISHED
from bench.trajectories import evenly_spaced

__all__ = ["PHOTOGRAPH_CASES"]

_FRAMES = 7
_SKY = ("0806", "0814", "0881", "0896", "0898")


def _photograph(dataset: str, scene: str, about: str) -> StabilityCase:
    def load(folder: Path) -> SceneCase:
        case = open_dataset(dataset).load(scene)
        return replace(case, eval_indices=evenly_spaced(len(case.trajectory), _FRAMES))

    name = f"{dataset.partition('-')[0]}-{scene}"
    return StabilityCase(name, "photographs", about, FINISHED, scene=load, needs=f"{dataset}/{scene}")


PHOTOGRAPH_CASES = (
    _photograph("photos", "rocket", "a rocket before the sky, depth guessed"),
    *(_photograph("div2k-subset", scene, "dominated by sky, a small network's depth") for scene in _SKY),
)
