"""What a view shows after anchors have been added, at the cost of the pixels that those reach (METHOD.md 5.5).

Every ray that meets no new anchor has the hits it had before, so its colour cannot have changed. Tiles that a new
footprint reaches into are looked at, as the whole view's would be, and in them only the rays that a new anchor meets.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orca.camera import Camera
from orca.conventions import Float32Array
from orca.render.renderer import Renderer, Rendering
from orca.render.selector import footprints
from orca.render.tiles import changed_tiles, reaching, tile_pixels

__all__ = ["Changed", "render_changed"]


@dataclass(frozen=True, eq=False)
class Changed:
    """Pixels of a view that were rendered again.

    Attributes:
        pixel: which ones, row by row, ascending, [n].
        rgb, alpha, depth: what they show, as in `Rendering`, [n, 3], [n], [n].
    """

    pixel: NDArray[np.int64]
    rgb: Float32Array
    alpha: Float32Array
    depth: Float32Array

    def write_to(self, rendering: Rendering) -> None:
        """Bring a rendering of the whole view up to date, in place."""
        rendering.rgb.reshape(-1, 3)[self.pixel] = self.rgb
        rendering.alpha.reshape(-1)[self.pixel] = self.alpha
        rendering.depth.reshape(-1)[self.pixel] = self.depth


def render_changed(
    renderer: Renderer,
    more: Renderer,
    camera: Camera,
    boxes: NDArray[np.int32],
    more_boxes: NDArray[np.int32],
) -> Changed:
    """Render the pixels of a view that new anchors reach.

    Args:
        renderer: the scene without them.
        more: the new anchors alone, with the same decoders and configuration.
        camera: the view.
        boxes: footprints of the scene's anchors in it (`Renderer.boxes`), [N, 4].
        more_boxes: those of the new ones.
    """
    size = (camera.width, camera.height)
    tiles = changed_tiles(more_boxes, size)
    near = reaching(boxes, tiles, size)
    if renderer.backend != "compiled":
        keep = np.zeros(len(boxes), bool)
        keep[near] = True
        whole = renderer.part(keep).extended(more).render(camera)
        pixel = tile_pixels(np.flatnonzero(tiles), size)
        rgb, alpha, depth = whole.rgb.reshape(-1, 3), whole.alpha.ravel(), whole.depth.ravel()
        return Changed(pixel, rgb[pixel], alpha[pixel], depth[pixel])
    means, whitening, opacity, carried = (
        np.concatenate([getattr(renderer, name)[near], getattr(more, name)])
        for name in ("means", "whitening", "opacity", "carried")
    )
    where, _ = footprints(means, whitening, camera, renderer.config)
    out, met, _ = renderer.render_tiles(camera, where, opacity, carried, np.flatnonzero(tiles), newest=len(near))
    pixel = np.flatnonzero(met)
    return Changed(pixel, *renderer.finished(out[pixel]))
