"""What a repair inserts must not show in the input view: it was hidden there, or it would not be a hole."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from orca.camera import Camera
from orca.conventions import Float32Array, Float64Array
from orca.render.changed import render_changed
from orca.render.renderer import Renderer

__all__ = ["InputSurface", "Trace", "trace_in"]

_MARGIN = 1.06  # a point this much behind a surface is behind it: more than a layer of the renderer spans (5 %)
_BEHIND = 1.01  # ... and this much, for what is only asked about and never inserted
_STEPS = 48  # depths tried along a ray
_HALVINGS = 4  # of the interval that the answer lies in
_FACTORS = np.concatenate([[1.0], 1.06 * 1.04 ** np.arange(22)])  # depths tried along a ray, up to 2.5 times


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

    @staticmethod
    def sharp(camera: Camera, depth: Float32Array, alpha: Float32Array) -> InputSurface:
        """From a render: pixels between two surfaces go to the nearer one, and where there is none, nothing hides."""
        low, high = (np.asarray(f(depth, np.ones((3, 3), np.uint8))) for f in (cv2.erode, cv2.dilate))
        snapped = np.where(depth - low < high - depth, low, high)
        torn = (high > 1.05 * low) & (low > 0)
        shown = np.where(torn, snapped, depth)
        return InputSurface(camera, np.where(alpha > 0.5, shown, 0.0).astype(np.float32))

    def least_depth(self, view: Camera, pixels: Float64Array, near: float, far: float) -> Float32Array:
        """The smallest z-depth between ``near`` and ``far`` at which the input camera would not see a point, [n].

        What a hole shows was not seen from the input, so it cannot lie in the space that the input looks through:
        at the hole's far side that leaves the background, at its near side what is just behind the foreground.

        Args:
            view: the view in which the hole is.
            pixels: hole pixels of the view, [n, 2].
            near, far: z-depths in the view; ``near`` is returned where nothing forbids it.
        """
        found = np.full(len(pixels), 1.0 / far)
        before = found.copy()  # inverse depths: the last one that is seen, and the first one that is not
        open_ = np.arange(len(pixels))
        start, direction = self.camera.rotation @ view.center + self.camera.translation, view.rays(pixels)
        step = (direction @ self.camera.rotation.T) @ self.camera.K.T
        base = self.camera.K @ start
        tried = np.linspace(1.0 / near, 1.0 / far, _STEPS)
        for k, inverse in enumerate(tried):
            hidden = self._behind(*(step[open_] / inverse + base).T)
            found[open_[hidden]], before[open_[hidden]] = inverse, tried[max(0, k - 1)]
            open_ = open_[~hidden]
            if len(open_) == 0:
                break
        for _ in range(_HALVINGS):
            middle = 0.5 * (found + before)
            hidden = self._behind(*(step / middle[:, None] + base).T)
            found, before = np.where(hidden, middle, found), np.where(hidden, before, middle)
        return (1.0 / found).astype(np.float32)

    def _behind(self, u: Float64Array, v: Float64Array, z: Float64Array) -> NDArray[np.bool_]:
        """Whether homogeneous pixels (u, v, z) of the input lie behind its surface or outside its image, [n]."""
        ahead = np.where(z > 0, z, 1.0)
        column, row = np.floor(u / ahead), np.floor(v / ahead)
        inside = (z > 0) & (column >= 0) & (row >= 0) & (column < self.camera.width) & (row < self.camera.height)
        column, row = np.where(inside, column, 0).astype(np.intp), np.where(inside, row, 0).astype(np.intp)
        return np.asarray(~inside | (z > _BEHIND * self.depth[row, column]))

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
        return np.asarray(~inside | (z > _MARGIN * self.depth[row, column]))


@dataclass(frozen=True, eq=False)
class Trace:
    """What new anchors change in the pixels of the input view that they reach.

    Attributes:
        change: largest change of a colour channel of each pixel, [n].
        cost: change of each pixel's squared error against the input image, over all channels, [n]; 0 without one.
        anchors: which of the new anchors each pixel's ray meets, [n, K], -1 where there are fewer.
        count: how many new anchors there are.
    """

    change: Float32Array
    cost: Float32Array
    anchors: NDArray[np.int64]
    count: int

    def guilty(self, tolerance: float) -> NDArray[np.bool_]:
        """The new anchors on rays whose pixel changes by more than ``tolerance``, [count]."""
        found = np.zeros(self.count, bool)
        met = self.anchors[self.change > tolerance]
        found[met[met >= 0]] = True
        return found

    def cost_within(self, tolerance: float) -> float:
        """Squared error that pixels which change by no more than ``tolerance`` add."""
        return float(self.cost[self.change <= tolerance].sum())


def trace_in(
    new: Renderer,
    scene: Renderer,
    camera: Camera,
    boxes: NDArray[np.int32],
    before: Float32Array,
    image: Float32Array | None,
) -> Trace | None:
    """What new anchors change in the input view; None if they do not reach it.

    A soft foreground edge lets through a little of what lies behind it, so being behind the surface is not enough.

    Args:
        new: a renderer of the anchors about to be inserted alone.
        scene: a renderer of the scene without them.
        camera: the input camera.
        boxes: footprints of the scene's anchors in its view (`Renderer.boxes`), [N, 4].
        before: its render without the new anchors, [H, W, 3].
        image: the input image, [H, W, 3]; None if it is not at hand.
    """
    changed = render_changed(scene, new, camera, boxes, new.boxes(camera))
    if len(changed.pixel) == 0:
        return None
    after, before = changed.rgb, before.reshape(-1, 3)[changed.pixel]
    cost = np.zeros(len(after), np.float32)
    if image is not None:
        wanted = image.reshape(-1, 3)[changed.pixel]
        cost = (np.square(np.clip(after, 0, 1) - wanted) - np.square(np.clip(before, 0, 1) - wanted)).sum(1)
    met = new.hits(camera).padded(changed.pixel)
    return Trace(np.abs(after - before).max(1), cost, met, len(new.anchors))
