"""Outpainting with an inpainter: the margin is a hole, filled at once or tile by tile from the frame outwards."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orca.conventions import Float32Array
from orca.errors import BadInput
from orca.priors.diffusion import DiffusionInpainter
from orca.priors.diffusion_config import DiffusionConfig
from orca.priors.exemplar import ExemplarInpainter
from orca.priors.hub import ModelAccess
from orca.priors.inpaint import Inpainter

__all__ = ["ClassicalOutpainter", "DiffusionOutpainter", "InpaintingOutpainter", "tiles_outwards"]

Box = tuple[int, int, int, int]  # x0, y0, x1, y1 in pixels, the far ends excluded


@dataclass(frozen=True)
class InpaintingOutpainter:
    """Grows an image by inpainting its margin.

    Attributes:
        inpainter: fills the margin.
        name: its name in the registry of outpainters.
        tile: side in pixels of what the inpainter sees at a time; 0 shows it the whole canvas.
        overlap: share of a tile that is known already (O: 0.25).
    """

    inpainter: Inpainter
    name: str
    tile: int = 0
    overlap: float = 0.25

    def outpaint(self, image: Float32Array, left: int, top: int, right: int, bottom: int) -> Float32Array:
        """See `Outpainter`."""
        if image.ndim != 3 or image.shape[2] != 3 or image.size == 0:
            raise BadInput(f"image of shape {image.shape}", "[H, W, 3]", "give an RGB image")
        margins = (left, top, right, bottom)
        if min(margins) < 0:
            raise BadInput(f"margins {margins}", "left, top, right, bottom >= 0", "use 0 where nothing is added")
        height, width = image.shape[:2]
        canvas = np.pad(np.asarray(image, np.float32), ((top, bottom), (left, right), (0, 0)))
        unknown = np.ones(canvas.shape[:2], bool)
        unknown[top : top + height, left : left + width] = False
        for x0, y0, x1, y1 in tiles_outwards((width, height), margins, self.tile, self.overlap):
            part = slice(y0, y1), slice(x0, x1)
            canvas[part] = self.inpainter.inpaint(canvas[part], unknown[part])
            unknown[part] = False
        return canvas


class ClassicalOutpainter(InpaintingOutpainter):
    """``classical``: the image goes on with its own patches (`ExemplarInpainter`), on the whole canvas at once."""

    def __init__(self, seed: int = 0) -> None:
        super().__init__(ExemplarInpainter(seed=seed), "classical")


class DiffusionOutpainter(InpaintingOutpainter):
    """``sd15``: Stable Diffusion 1.5 inpainting, tile by tile at the image's own resolution."""

    def __init__(self, access: ModelAccess | None = None, config: DiffusionConfig | None = None, seed: int = 0) -> None:
        config = config or DiffusionConfig()
        super().__init__(DiffusionInpainter(access or ModelAccess(), config, seed), "sd15", config.side)


def tiles_outwards(
    size: tuple[int, int], margins: tuple[int, int, int, int], tile: int, overlap: float
) -> Iterator[Box]:
    """Boxes on the canvas, each with something known in it, that cover the margin; the known part grows as they go.

    Left, right, top, bottom take turns, each a strip of at most ``(1 - overlap) * tile`` pixels at a time, cut into
    tiles along its length.

    Args:
        size: (width, height) of the image.
        margins: left, top, right, bottom.
        tile: side of a box; 0 gives one box, the canvas.
        overlap: share of a box that reaches into the known part.
    """
    left, top, right, bottom = margins
    canvas = (size[0] + left + right, size[1] + top + bottom)
    if not any(margins):
        return
    if tile <= 0:
        yield 0, 0, *canvas
        return
    known: NDArray[np.int64] = np.array([left, top, left + size[0], top + size[1]])  # x0, y0, x1, y1
    end = np.array([0, 0, *canvas])
    step = max(1, int((1.0 - overlap) * tile))
    while (known != end).any():
        for side in (0, 2, 1, 3):
            if known[side] == end[side]:
                continue
            grown = known.copy()
            if side < 2:
                grown[side] = max(end[side], known[side] - step)
                across = (int(grown[side]), min(int(grown[side]) + tile, canvas[side]))
            else:
                grown[side] = min(end[side], known[side] + step)
                across = (max(0, int(grown[side]) - tile), int(grown[side]))
            axis = side % 2
            for start, stop in _along(int(known[1 - axis]), int(known[3 - axis]), tile, overlap):
                yield (across[0], start, across[1], stop) if axis == 0 else (start, across[0], stop, across[1])
            known = grown


def _along(low: int, high: int, tile: int, overlap: float) -> Iterator[tuple[int, int]]:
    """Intervals of at most ``tile`` pixels that cover [low, high), evenly spaced, each overlapping the one before."""
    length = high - low
    count = 1 if length <= tile else 1 + -(-(length - tile) // max(1, int((1.0 - overlap) * tile)))
    for i in range(count):
        start = low + (0 if count == 1 else round(i * (length - tile) / (count - 1)))
        yield start, min(high, start + tile)
