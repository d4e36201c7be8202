"""The result of ray selection: for every ray its hits, nearest first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orca.conventions import Float32Array

__all__ = ["HitList"]


@dataclass(frozen=True, eq=False)
class HitList:
    """Hits of all rays of one view in one compressed table.

    The hits of ray r are the rows ``start[r] : start[r] + count[r]``, sorted by (t_hit, anchor).

    Attributes:
        start: first row of each ray, [R] int64.
        count: kept hits of each ray, [R] int32, at most the cap.
        anchor: anchor index of each row, int32.
        t_hit: ray parameter t* of closest approach (z-depth for rays of unit camera z), float32.
        m2: squared Mahalanobis distance of the ray to the anchor, float32.
        precision: a_j = |A d|^2, the inverse variance along the ray, float32.
        overflow: hits beyond the cap, over all rays.
        culled_inside: anchors left out because the camera is inside their ellipsoid.
    """

    start: NDArray[np.int64]
    count: NDArray[np.int32]
    anchor: NDArray[np.int32]
    t_hit: Float32Array
    m2: Float32Array
    precision: Float32Array
    overflow: int
    culled_inside: int

    @property
    def num_rays(self) -> int:
        """How many rays there are, hit or not."""
        return len(self.start)

    def padded(self, rays: NDArray[np.int64] | None = None) -> NDArray[np.int64]:
        """Anchor indices as a rectangle [R, K], -1 where a ray has fewer hits; ``rays`` selects some rays."""
        start = self.start if rays is None else self.start[rays]
        count = self.count if rays is None else self.count[rays]
        k = max(1, int(count.max(initial=0)))
        column = np.arange(k)
        valid = column[None, :] < count[:, None]
        rows = np.where(valid, start[:, None] + column[None, :], 0)
        if len(self.anchor) == 0:
            return np.full((len(start), k), -1, np.int64)
        return np.where(valid, self.anchor[rows], -1).astype(np.int64)

    def flat(self, rays: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Hits of some rays one after another: which of ``rays`` each belongs to, and its anchor, both [H]."""
        start, count = self.start[rays], self.count[rays].astype(np.int64)
        ray = np.repeat(np.arange(len(rays)), count)
        rows = np.arange(len(ray)) + np.repeat(start - (np.cumsum(count) - count), count)
        return ray, self.anchor[rows].astype(np.int64)
