"""The watched views of a trajectory, kept up to date at the cost of what an insertion touches."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from orca.anchors import GaussianAnchors
from orca.camera import Camera
from orca.render.renderer import Renderer, Rendering
from orca.threads import map_on_cores

__all__ = ["Box", "WatchedViews", "crop_camera", "grown"]

_CELL = 32  # pixels a side of the cells that touched parts of a view are made of

Box = tuple[int, int, int, int]  # x0, y0, x1, y1 in pixels, the far ends excluded


class WatchedViews:
    """Renders of all watched views under the scene as it stands.

    After an insertion only the pixels that the new anchors' footprints can reach are rendered again: every other ray
    has the hits it had before, so its colour cannot have changed (METHOD.md 5.5). A test compares with full renders.

    Args:
        cameras: the views.
        renderer: renders the scene as it stands.
        progress: called as progress(done, total) while the views are rendered for the first time.
    """

    def __init__(
        self,
        cameras: Sequence[Camera],
        renderer: Renderer,
        progress: Callable[[int, int], None] = lambda done, total: None,
    ) -> None:
        self.cameras = tuple(cameras)
        self.renderer = renderer
        self.rendered: list[Rendering] = []
        self.boxes: list[NDArray[np.int32]] = []
        self.pixels_rendered_again = [0] * len(self.cameras)
        started = time.perf_counter()
        for i, camera in enumerate(self.cameras):
            self.rendered.append(renderer.render(camera))
            self.boxes.append(renderer.boxes(camera))
            progress(i + 1, len(self.cameras))
        self.seconds = time.perf_counter() - started  # what rendering all views costs

    def insert(self, new: GaussianAnchors) -> dict[int, Box]:
        """Add anchors to the scene and bring every view they touch up to date; returns what was rendered again."""
        alone = Renderer(new, self.renderer.decoders, self.renderer.config, self.renderer.device)
        self.renderer = self.renderer.extended(alone)

        def update(index: int) -> Box | None:
            boxes = alone.boxes(self.cameras[index])
            self.boxes[index] = np.concatenate([self.boxes[index], boxes])
            around = _around(boxes)
            if around is not None:
                self._render_again(index, around, _patches(boxes))
            return around

        touched = map_on_cores(update, range(len(self.cameras)))
        return {index: box for index, box in enumerate(touched) if box is not None}

    def footprint(self, new: GaussianAnchors, view: int = 0) -> Box | None:
        """Box around everything that some new anchors can touch in a view; None if nothing."""
        alone = Renderer(new, self.renderer.decoders, self.renderer.config, self.renderer.device)
        return _around(alone.boxes(self.cameras[view]))

    def reaching(self, view: int, box: Box) -> NDArray[np.bool_]:
        """Which anchors reach into a part of a view, [N]."""
        return _reaching(self.boxes[view], box)

    def _render_again(self, index: int, around: Box, patches: list[Box]) -> None:
        keep = self.reaching(index, around)
        near, boxes = self.renderer.part(keep), self.boxes[index][keep]
        before = self.rendered[index]
        for box in patches:
            part = near.part(_reaching(boxes, box)).render(crop_camera(self.cameras[index], box))
            for whole, patch in ((before.rgb, part.rgb), (before.alpha, part.alpha), (before.depth, part.depth)):
                whole[box[1] : box[3], box[0] : box[2]] = patch
            self.pixels_rendered_again[index] += (box[2] - box[0]) * (box[3] - box[1])


def _reaching(boxes: NDArray[np.int32], box: Box) -> NDArray[np.bool_]:
    """Which footprints, by their boxes, reach into a part of a view, [N]."""
    x0, y0, x1, y1 = box
    return np.asarray((boxes[:, 0] < x1) & (boxes[:, 2] > x0) & (boxes[:, 1] < y1) & (boxes[:, 3] > y0))


def _around(boxes: NDArray[np.int32]) -> Box | None:
    boxes = boxes[(boxes[:, 2] > boxes[:, 0]) & (boxes[:, 3] > boxes[:, 1])]
    if len(boxes) == 0:
        return None
    low, high = boxes[:, :2].min(0), boxes[:, 2:].max(0)
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])


def _patches(boxes: NDArray[np.int32]) -> list[Box]:
    """A few disjoint boxes that cover some footprints more closely than the box around them all.

    Holes lie along silhouettes, thin and bent: the box around one can be ten times its area. Cells that a footprint
    reaches are joined along rows, and rows of one extent are joined with each other.
    """
    around = _around(boxes)
    if around is None:
        return []
    left, top, right, bottom = around
    boxes = boxes[(boxes[:, 2] > boxes[:, 0]) & (boxes[:, 3] > boxes[:, 1])]
    cells = (boxes.astype(np.int64) - np.array([left, top, left + 1, top + 1])) // _CELL
    # A footprint adds one at its first cell and takes it back after its last one, along both axes.
    count = np.zeros(((bottom - top - 1) // _CELL + 2, (right - left - 1) // _CELL + 2), np.int64)
    for row, column, sign in ((1, 0, 1), (3, 0, -1), (1, 2, -1), (3, 2, 1)):
        np.add.at(count, (cells[:, row] + (row == 3), cells[:, column] + (column == 2)), sign)
    reached = count.cumsum(0).cumsum(1)[:-1, :-1] > 0
    patches: list[Box] = []
    for y, cells_of_row in enumerate(reached):
        ends = np.flatnonzero(np.diff(np.concatenate([[False], cells_of_row, [False]]).astype(np.int8)))
        low, high = top + y * _CELL, min(bottom, top + (y + 1) * _CELL)
        for x0, x1 in zip(left + _CELL * ends[::2], np.minimum(right, left + _CELL * ends[1::2]), strict=True):
            above = next((i for i, p in enumerate(patches) if (p[0], p[2], p[3]) == (x0, x1, low)), None)
            if above is None:
                patches.append((int(x0), low, int(x1), high))
            else:
                patches[above] = (int(x0), patches[above][1], int(x1), high)
    return patches


def grown(box: Box, by: int, camera: Camera) -> Box:
    """A box, larger by so many pixels on every side, within the view."""
    x0, y0, x1, y1 = box
    return max(0, x0 - by), max(0, y0 - by), min(camera.width, x1 + by), min(camera.height, y1 + by)


def crop_camera(camera: Camera, box: Box) -> Camera:
    """The camera of a part of the image, (x0, y0, x1, y1)."""
    x0, y0, x1, y1 = box
    return camera.padded(-x0, -y0, x1 - camera.width, y1 - camera.height)
