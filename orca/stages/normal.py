"""Normal equations of the closed-form fit, and preconditioned conjugate gradients for three channels at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from orca.conventions import Float32Array
from orca.stages.linear import LinearView
from orca.threads import kernel

__all__ = ["NormalEquations", "conjugate_gradients"]


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """J^T J + damping, J = gather diag(slope) weights: what a colour logit of an anchor does to the pixels.

    Attributes:
        view: the observations.
        slope: derivative of each sample's colours by their logits, [S, 3].
        damping: added to the diagonal.
    """

    view: LinearView
    slope: Float32Array
    damping: float

    def times(self, x: Float32Array) -> Float32Array:
        """Product with [N, 3], in two sweeps over the weights."""
        weights, view = self.view.weights, self.view
        back = _through_rays(*weights.rows, view.start, view.share, self.slope, x)
        return np.asarray(_to_anchors(*weights.columns, back, x, self.damping), np.float32)

    def diagonal(self) -> Float32Array:
        """Diagonal of each channel, [N, 3], without what two samples of one ray have in common."""
        scale = self.slope * self.view.share[:, None]
        return np.asarray(_diagonal(*self.view.weights.columns, scale, self.damping), np.float32)


def conjugate_gradients(
    times: Callable[[Float32Array], Float32Array], b: Float32Array, diagonal: Float32Array, steps: int
) -> Float32Array:
    """Solve A x = b, [N, 3], each channel with its own step lengths; ``diagonal`` [N, 3] preconditions.

    Anchors of a quadtree differ by a factor of 64 in the pixels that they answer for, and so do their equations.
    """
    x, r = np.zeros_like(b), b.copy()
    z = r / diagonal
    p, energy = z.copy(), _dot(r, z)
    for _ in range(steps):
        q = times(p)
        length = energy / np.maximum(_dot(p, q), 1e-30)
        x += length * p
        r -= length * q
        np.divide(r, diagonal, out=z)
        new_energy = _dot(r, z)
        p *= new_energy / np.maximum(energy, 1e-30)
        p += z
        energy = new_energy
    return x


def _dot(a: Float32Array, b: Float32Array) -> Float32Array:
    return np.asarray(np.einsum("nc,nc->c", a, b, dtype=np.float64), np.float32)


@kernel(error_model="numpy")
def _through_rays(
    indptr: NDArray[np.int64],
    indices: NDArray[np.int32],
    values: Float32Array,
    start: NDArray[np.int64],
    share: Float32Array,
    slope: Float32Array,
    x: Float32Array,
) -> Float32Array:
    """diag(slope) gather^T gather diag(slope) weights x, [S, 3]."""
    out = np.empty((len(share), 3), np.float32)
    for r in numba.prange(len(start) - 1):
        red, green, blue = np.float32(0), np.float32(0), np.float32(0)
        for s in range(start[r], start[r + 1]):
            a, b, c = np.float32(0), np.float32(0), np.float32(0)
            for k in range(indptr[s], indptr[s + 1]):
                w, j = values[k], indices[k]
                a += w * x[j, 0]
                b += w * x[j, 1]
                c += w * x[j, 2]
            red += share[s] * slope[s, 0] * a
            green += share[s] * slope[s, 1] * b
            blue += share[s] * slope[s, 2] * c
        for s in range(start[r], start[r + 1]):
            out[s, 0] = share[s] * slope[s, 0] * red
            out[s, 1] = share[s] * slope[s, 1] * green
            out[s, 2] = share[s] * slope[s, 2] * blue
    return out


@kernel(error_model="numpy")
def _to_anchors(
    indptr: NDArray[np.int64],
    indices: NDArray[np.int32],
    values: Float32Array,
    samples: Float32Array,
    x: Float32Array,
    damping: float,
) -> Float32Array:
    """weights^T samples + damping x, [N, 3]."""
    out = np.empty_like(x)
    keep = np.float32(damping)
    for j in numba.prange(len(indptr) - 1):
        a, b, c = keep * x[j, 0], keep * x[j, 1], keep * x[j, 2]
        for k in range(indptr[j], indptr[j + 1]):
            w, s = values[k], indices[k]
            a += w * samples[s, 0]
            b += w * samples[s, 1]
            c += w * samples[s, 2]
        out[j, 0], out[j, 1], out[j, 2] = a, b, c
    return out


@kernel(error_model="numpy")
def _diagonal(
    indptr: NDArray[np.int64], indices: NDArray[np.int32], values: Float32Array, scale: Float32Array, damping: float
) -> Float32Array:
    out = np.empty((len(indptr) - 1, 3), np.float32)
    for j in numba.prange(len(indptr) - 1):
        for c in range(3):
            total = np.float32(damping)
            for k in range(indptr[j], indptr[j + 1]):
                through = values[k] * scale[indices[k], c]
                total += through * through
            out[j, c] = total
    return out
