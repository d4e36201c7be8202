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
                self._render_again(index, around)
            return around

        touched = map_on_cores(update, range(len(self.cameras)))
        return {index: box for index, box in enumerate(touched) if box is not None}

    def footprint(self, new: GaussianAnchors, view: int = 0) -> Box | None:
        """Box around everything that some new anchors can touch in a view; None if nothing."""
        alone = Renderer(new, self.renderer.decoders, self.renderer.config, self.renderer.device)
        return _around(alone.boxes(self.cameras[view]))

    def reaching(self, view: int, box: Box) -> NDArray[np.bool_]:
        """Which anchors reach into a part of a view, [N]."""
        b = self.boxes[view]
        return np.asarray((b[:, 0] < box[2]) & (b[:, 2] > box[0]) & (b[:, 1] < box[3]) & (b[:, 3] > box[1]))

    def _render_again(self, index: int, box: Box) -> None:
        part = self.renderer.part(self.reaching(index, box)).render(crop_camera(self.cameras[index], box))
        before = self.rendered[index]
        for whole, patch in ((before.rgb, part.rgb), (before.alpha, part.alpha), (before.depth, part.depth)):
            whole[box[1] : box[3], box[0] : box[2]] = patch
        self.pixels_rendered_again[index] += (box[2] - box[0]) * (box[3] - box[1])


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
