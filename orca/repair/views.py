"""The watched views of a trajectory, kept up to date at the cost of what an insertion touches."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from orca.camera import Camera
from orca.render.changed import render_changed
from orca.render.renderer import Renderer, Rendering
from orca.render.rows import SharedRows
from orca.threads import map_on_cores

__all__ = ["Box", "WatchedViews", "crop_camera", "grown"]

Box = tuple[int, int, int, int]  # x0, y0, x1, y1 in pixels, the far ends excluded


class WatchedViews:
    """Renders of all watched views under the scene as it stands.

    After an insertion only the pixels that the new anchors reach are rendered again (`render_changed`). A test compares
    with full renders.

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
        self._rows: list[SharedRows] = []  # the memory of the boxes
        self.pixels_rendered_again = [0] * len(self.cameras)
        started = time.perf_counter()
        for i, camera in enumerate(self.cameras):
            self.rendered.append(renderer.render(camera))
            self.boxes.append(renderer.boxes(camera))
            self._rows.append(SharedRows(self.boxes[-1]))
            progress(i + 1, len(self.cameras))
        self.seconds = time.perf_counter() - started  # what rendering all views costs

    def insert(self, new: Renderer) -> dict[int, Box]:
        """Add anchors, given as a renderer of them alone, and bring every view they touch up to date.

        Returns a box around everything that has changed, of each of these views. That the scene is a larger one
        (`Renderer.extended`) is for the caller to note in ``renderer``, once for all that watch it.
        """

        def update(index: int) -> Box | None:
            boxes = new.boxes(self.cameras[index])
            before, around = self.boxes[index], _around(boxes)
            self._rows[index], self.boxes[index] = self._rows[index].extended(len(before), boxes)
            if around is not None:
                changed = render_changed(self.renderer, new, self.cameras[index], before, boxes)
                changed.write_to(self.rendered[index])
                self.pixels_rendered_again[index] += len(changed.pixel)
            return around

        touched = map_on_cores(update, range(len(self.cameras)))
        return {index: box for index, box in enumerate(touched) if box is not None}

    def reaching(self, view: int, box: Box) -> NDArray[np.bool_]:
        """Which anchors reach into a part of a view, [N]."""
        return _reaching(self.boxes[view], box)


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


def grown(box: Box, by: int, camera: Camera) -> Box:
    """A box, larger by so many pixels on every side, within the view."""
    x0, y0, x1, y1 = box
    return max(0, x0 - by), max(0, y0 - by), min(camera.width, x1 + by), min(camera.height, y1 + by)


def crop_camera(camera: Camera, box: Box) -> Camera:
    """The camera of a part of the image, (x0, y0, x1, y1)."""
    x0, y0, x1, y1 = box
    return camera.padded(-x0, -y0, x1 - camera.width, y1 - camera.height)
