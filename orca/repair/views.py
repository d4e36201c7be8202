"""The watched views of a trajectory, kept up to date at the cost of what an insertion touches."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from orca.anchors import GaussianAnchors
from orca.camera import Camera
from orca.conventions import Float32Array
from orca.render.conics import project_anchors
from orca.render.renderer import Renderer, Rendering

__all__ = ["WatchedViews"]


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
        self.pixels_rendered_again = 0
        for i, camera in enumerate(self.cameras):
            self.rendered.append(renderer.render(camera))
            progress(i + 1, len(self.cameras))

    def insert(self, new: GaussianAnchors) -> list[int]:
        """Add anchors to the scene and bring every view they touch up to date; returns those views' indices."""
        self.renderer = self.renderer.extended(new)
        touched = []
        for i, camera in enumerate(self.cameras):
            box = self._footprint(new, camera)
            if box is not None:
                self._render_again(i, box)
                touched.append(i)
        return touched

    def _footprint(self, new: GaussianAnchors, camera: Camera) -> tuple[int, int, int, int] | None:
        """Bounding box (x0, y0, x1, y1) of everything the new anchors can touch in a view."""
        config = self.renderer.config
        _, boxes, _ = project_anchors(
            new.means.numpy(),
            np.ascontiguousarray(new.whitening().numpy()),
            camera.world_to_camera,
            camera.K,
            camera.pixel_to_ray(),
            (camera.width, camera.height),
            config.chi2,
            config.near,
        )
        boxes = boxes[(boxes[:, 2] > boxes[:, 0]) & (boxes[:, 3] > boxes[:, 1])]
        if len(boxes) == 0:
            return None
        low, high = boxes[:, :2].min(0), boxes[:, 2:].max(0)
        return int(low[0]), int(low[1]), int(high[0]), int(high[1])

    def _render_again(self, index: int, box: tuple[int, int, int, int]) -> None:
        x0, y0, x1, y1 = box
        part = self.renderer.render(crop_camera(self.cameras[index], box))
        before = self.rendered[index]
        rgb, alpha, depth = before.rgb.copy(), before.alpha.copy(), before.depth.copy()
        for whole, patch in ((rgb, part.rgb), (alpha, part.alpha), (depth, part.depth)):
            _paste(whole, patch, box)
        self.rendered[index] = Rendering(rgb, alpha, depth, before.overflow + part.overflow)
        self.pixels_rendered_again += (x1 - x0) * (y1 - y0)


def crop_camera(camera: Camera, box: tuple[int, int, int, int]) -> Camera:
    """The camera of a part of the image, (x0, y0, x1, y1)."""
    x0, y0, x1, y1 = box
    return camera.padded(-x0, -y0, x1 - camera.width, y1 - camera.height)


def _paste(whole: Float32Array, patch: Float32Array, box: tuple[int, int, int, int]) -> None:
    x0, y0, x1, y1 = box
    whole[y0:y1, x0:x1] = patch
