"""What rays see of anchors with certain colour logits, and what that says of the samples along them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orca.conventions import Float32Array
from orca.stages.linear import LinearView
from orca.threads import kernel

__all__ = ["Forward", "forward"]

_LEAST_SLOPE = 1e-3  # of the sigmoid: a colour near 0 or 1 can still move


@dataclass(frozen=True, eq=False)
class Forward:
    """Observations as they are seen.

    Attributes:
        seen: colour of each ray, [R, 3].
        slope: derivative of each sample's colours by their logits, [S, 3].
        missing: what each ray lacks of its target, times how much a sample's logits change the ray, [S, 3]: the
            gradient by the samples.
    """

    seen: Float32Array
    slope: Float32Array
    missing: Float32Array


def forward(view: LinearView, colours: Float32Array) -> Forward:
    """See anchors that carry the logits ``colours``, [N, 3]."""
    seen = np.empty((len(view.start) - 1, 3), np.float32)
    slope, missing = (np.empty((len(view.share), 3), np.float32) for _ in range(2))
    _forward(len(seen), *view.weights.rows, view.start, view.share, view.target, colours, seen, slope, missing)
    return Forward(seen, slope, missing)


@kernel(error_model="numpy")
def _forward(
    first: int,
    end: int,
    indptr: NDArray[np.int64],
    indices: NDArray[np.int32],
    values: Float32Array,
    start: NDArray[np.int64],
    share: Float32Array,
    target: Float32Array,
    x: Float32Array,
    seen: Float32Array,
    slope: Float32Array,
    missing: Float32Array,
) -> None:
    one = np.float32(1)
    for r in range(first, end):
        red, green, blue = np.float32(0), np.float32(0), np.float32(0)
        for s in range(start[r], start[r + 1]):
            a, b, c = np.float32(0), np.float32(0), np.float32(0)
            for k in range(indptr[s], indptr[s + 1]):
                w, j = values[k], indices[k]
                a += w * x[j, 0]
                b += w * x[j, 1]
                c += w * x[j, 2]
            a, b, c = one / (one + np.exp(-a)), one / (one + np.exp(-b)), one / (one + np.exp(-c))
            red += share[s] * a
            green += share[s] * b
            blue += share[s] * c
            slope[s, 0], slope[s, 1], slope[s, 2] = a * (one - a), b * (one - b), c * (one - c)
        seen[r, 0], seen[r, 1], seen[r, 2] = red, green, blue
        for s in range(start[r], start[r + 1]):
            for i in range(3):
                slope[s, i] = max(slope[s, i], np.float32(_LEAST_SLOPE))
                missing[s, i] = share[s] * slope[s, i] * (target[r, i] - seen[r, i])
