"""What stages 1 and 2 are fitted to: the original's pixels, and the canvas pixels that lie outside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orca.camera import Camera
from orca.conventions import Float32Array
from orca.stages.canvas import Canvas

__all__ = ["GROWTH_RESOLUTION", "MARGIN_RESOLUTION", "Observation", "observations"]

MARGIN_RESOLUTION = 4.0
"""The outpainted margin is blurred; its anchors need no finer observations than this spacing in pixels."""

GROWTH_RESOLUTION = 8.0
"""The same while anchors grow: where to split is seen as well, and the margin costs a fifth and not half of a fit."""


@dataclass(frozen=True, eq=False)
class Observation:
    """One image to reproduce.

    Attributes:
        camera: the camera it is seen by.
        rays: which pixels count, row-major indices, [R] int64.
        colour: their colours, [R, 3] float32.
    """

    camera: Camera
    rays: NDArray[np.int64]
    colour: Float32Array


def observations(canvas: Canvas, margin_spacing: float) -> tuple[Observation, ...]:
    """The original at full resolution, then the margin at the resolution that its anchors can carry.

    Where the two images overlap the original has priority, so the canvas gives only what lies outside it.
    """
    rows, columns = canvas.original
    left, top, right, bottom = canvas.margins
    inner = canvas.camera.padded(-left, -top, -right, -bottom)
    image = canvas.image[rows, columns]
    first = Observation(inner, np.arange(image.shape[0] * image.shape[1]), image.reshape(-1, 3))
    if not any(canvas.margins):
        return (first,)
    import cv2

    # Half the margin's anchor spacing is enough to determine its anchors, at a fraction of the rays.
    step = max(1.0, margin_spacing / 2)
    height, width = canvas.image.shape[:2]
    small = (max(1, round(width / step)), max(1, round(height / step)))
    outside = np.ones((height, width), np.uint8)
    outside[rows, columns] = 0
    image = np.asarray(cv2.resize(canvas.image, small, interpolation=cv2.INTER_AREA), np.float32)
    keep = cv2.resize(outside.astype(np.float32), small, interpolation=cv2.INTER_AREA).ravel() > 0.999
    rays = np.flatnonzero(keep)
    return first, Observation(canvas.camera.resized(*small), rays, image.reshape(-1, 3)[rays])
