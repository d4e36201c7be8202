"""What a repair inserts must not show in the input view: it was hidden there, or it would not be a hole."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from orca.anchors import GaussianAnchors
from orca.camera import Camera
from orca.conventions import Float32Array, Float64Array
from orca.render.renderer import Renderer

__all__ = ["InputSurface", "visible_in"]

_FACTORS = np.concatenate([[1.0], 1.01 * 1.04 ** np.arange(24)])  # depths tried along a ray, up to 2.5 times


@dataclass(frozen=True, eq=False)
class InputSurface:
    """The surface that the input camera sees.

    Attributes:
        camera: the input camera.
        depth: its z-depth, [H, W]; the largest within the window that an inserted anchor may reach into.
    """

    camera: Camera
    depth: Float32Array

    @staticmethod
    def of(camera: Camera, depth: Float32Array, window: int = 9) -> InputSurface:
        """From the input view's depth [H, W]; ``window`` is the side in pixels of what an anchor may touch."""
        return InputSurface(camera, np.asarray(cv2.dilate(depth, np.ones((window, window), np.uint8)), np.float32))

    def push_behind(
        self, view: Camera, pixels: Float64Array, depth: Float64Array
    ) -> tuple[Float64Array, NDArray[np.bool_]]:
        """Move points away from a view, along its rays, until the input camera cannot see them.

        Args:
            view: the view in which the hole is.
            pixels: hole pixels of the view, [n, 2].
            depth: wanted z-depth in the view, [n].

        Returns:
            The smallest sufficient depth among a fixed set of multiples, [n], and whether one was found, [n]. Points
            outside the input image need no hiding.
        """
        out, hidden = np.array(depth, np.float64), np.zeros(len(depth), bool)
        for factor in _FACTORS:
            open_ = np.flatnonzero(~hidden)
            if len(open_) == 0:
                break
            trial = depth[open_] * factor
            ok = self.is_hidden(view.unproject(pixels[open_], trial))
            out[open_[ok]], hidden[open_[ok]] = trial[ok], True
        return out, hidden

    def is_hidden(self, points: Float64Array) -> NDArray[np.bool_]:
        """Whether world points [n, 3] lie behind the input's surface or outside its image, [n]."""
        pixels, z = self.camera.project(points)
        inside = (z > 0) & (pixels > -1).all(1) & (pixels < [self.camera.width + 1, self.camera.height + 1]).all(1)
        column = np.clip(np.nan_to_num(pixels[:, 0]), 0, self.camera.width - 1).astype(int)
        row = np.clip(np.nan_to_num(pixels[:, 1]), 0, self.camera.height - 1).astype(int)
        return np.asarray(~inside | (z > 1.005 * self.depth[row, column]))


def visible_in(
    new: GaussianAnchors, near: Renderer, camera: Camera, before: Float32Array, tolerance: float
) -> NDArray[np.bool_]:
    """Which new anchors change the input view, [n].

    A soft foreground edge lets through a little of what lies behind it, so being behind the surface is not enough.

    Args:
        new: anchors about to be inserted.
        near: renderer of the scene, or of the part of it that the view's crop needs.
        camera: the input camera, or a crop of it that contains all footprints of the new anchors.
        before: its render without them, [H, W, 3].
        tolerance: largest change of a colour channel that is let pass.
    """
    alone = Renderer(new, near.decoders, near.config, near.device)
    after = near.extended(alone).render(camera).rgb
    changed = (np.abs(after - before).max(2) > tolerance).ravel()
    hits = alone.hits(camera)
    padded = hits.padded(np.flatnonzero(changed))
    guilty = np.zeros(len(new), bool)
    guilty[padded[padded >= 0]] = True
    return guilty
