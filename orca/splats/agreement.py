"""How far a splat file's picture is from the neural one."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from orca.camera import Camera
from orca.conventions import Float32Array, to_float, to_uint8
from orca.splats.model import Splats
from orca.splats.view import render_splats

if TYPE_CHECKING:
    from orca.scene import Scene

__all__ = ["agreement", "held_out"]

_IDENTICAL_DB = 100.0  # what two equal pictures count as
_SAME_PLACE = 1e-6  # difference of two poses that are one, in scene radii


def agreement(scene: Scene, splats: Splats, cameras: Sequence[Camera]) -> list[float]:
    """PSNR in dB between the splats' picture and ORCA's own, both in bytes, for each camera; at most 100."""
    renderer = scene.renderer()
    background = scene.render_config.background
    return [_psnr(render_splats(splats, c, background), renderer.render(c).rgb) for c in cameras]


def held_out(path: Sequence[Camera], fitted: Sequence[int], first: Camera, count: int = 4) -> list[int]:
    """Frames of a path to test on: evenly spaced, and as far as can be from those that were fitted.

    A path may pass the same place twice: frames with the pose of a fitted one, or of ``first``, the input view, which
    is always fitted, are no test.
    """
    known = [first.world_to_camera, *(path[i].world_to_camera for i in fitted)]
    seen = [any(np.allclose(view.world_to_camera, pose, atol=_SAME_PLACE) for pose in known) for view in path]
    free = [i for i, same in enumerate(seen) if not same]
    if not free or count < 1:
        return []
    distance = [min((abs(i - j) for j, same in enumerate(seen) if same), default=0) for i in free]
    bounds = np.linspace(0, len(free), min(count, len(free)) + 1).astype(int)
    return [free[max(range(low, high), key=distance.__getitem__)] for low, high in pairwise(bounds)]


def _psnr(a: Float32Array, b: Float32Array) -> float:
    error = float(np.mean((to_float(to_uint8(a)) - to_float(to_uint8(b))) ** 2))
    return _IDENTICAL_DB if error == 0 else min(_IDENTICAL_DB, -10 * float(np.log10(error)))
