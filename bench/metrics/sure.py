"""Which input pixels each evaluated view surely shows: computed once a scene, for all methods and metrics."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from bench.datasets.case import SceneCase
from bench.warping import sure_points
from orca.camera import Camera

__all__ = ["SURE_RULE", "SureMasks", "forget_sure_masks", "sure_masks"]

CASES_KEPT = 32
SURE_RULE = "sure pixels: occlusion window 5 px, depth tolerance 2 %, no depth edge > 5 % in 3x3"


@dataclass(frozen=True, eq=False)
class SureMasks:
    """Sure input pixels of every evaluated frame, one bit each (32 kB for a frame of 512x512).

    Attributes:
        packed: one array of bits a frame.
        shares: share of the input pixels that are sure, a frame.
        pixels: number of input pixels.
    """

    packed: tuple[NDArray[np.uint8], ...]
    shares: tuple[float, ...]
    pixels: int

    def __iter__(self) -> Iterator[NDArray[np.bool_]]:
        for packed in self.packed:
            yield np.unpackbits(packed, count=self.pixels).astype(np.bool_)


def sure_masks(case: SceneCase) -> SureMasks:
    """The sure pixels (`bench.warping.sure_points`) of every camera of ``case.eval_trajectory``."""
    return _computed(_CaseKey.of(case))


def forget_sure_masks() -> None:
    """Drop what is kept in memory."""
    _computed.cache_clear()


@dataclass(frozen=True)
class _CaseKey:
    """A scene case that equals another when everything the sure pixels depend on is equal."""

    sha256: str
    case: SceneCase = field(compare=False, repr=False)

    @staticmethod
    def of(case: SceneCase) -> _CaseKey:
        digest = hashlib.sha256(case.eval_trajectory.sha256.encode())
        for array in (case.depth, case.camera.K, case.camera.world_to_camera):
            digest.update(str(array.shape).encode())
            digest.update(np.ascontiguousarray(array).tobytes())
        return _CaseKey(digest.hexdigest(), case)


@lru_cache(maxsize=CASES_KEPT)
def _computed(key: _CaseKey) -> SureMasks:
    from orca.threads import map_on_cores  # loads torch

    case = key.case

    def work(camera: Camera) -> tuple[NDArray[np.uint8], float]:
        sure, _ = sure_points(case.depth, case.camera, camera)
        return np.packbits(sure), float(sure.mean())

    found = map_on_cores(work, case.eval_trajectory.cameras())
    return SureMasks(tuple(packed for packed, _ in found), tuple(share for _, share in found), case.depth.size)
