"""Normal equations of the closed-form fit, and preconditioned conjugate gradients for three channels at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

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
        back, out = np.empty((len(view.share), 3), np.float32), np.empty_like(x)
        _through_rays(len(view.start) - 1, *weights.rows, view.start, view.share, self.slope, x, back)
        _to_anchors(len(x), *weights.columns, back, x, self.damping, out)
        return out

    def at_anchors(self, samples: Float32Array) -> Float32Array:
        """Transpose of the weights times samples [S, 3], [N, 3]."""
        columns = self.view.weights.columns
        out = np.empty((len(columns[0]) - 1, 3), np.float32)
        _to_anchors(len(out), *columns, samples, out, 0.0, out)
        return out

    def diagonal(self) -> Float32Array:
        """Diagonal of each channel, [N, 3], without what two samples of one ray have in common."""
        scale = self.slope * self.view.share[:, None]
        columns = self.view.weights.columns
        out = np.empty((len(columns[0]) - 1, 3), np.float32)
        _diagonal(len(out), *columns, scale, self.damping, out)
        return out


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
    first: int,
    end: int,
    indptr: NDArray[np.int64],
    indices: NDArray[np.int32],
    values: Float32Array,
    start: NDArray[np.int64],
    share: Float32Array,
    slope: Float32Array,
    x: Float32Array,
    out: Float32Array,
) -> None:
    """diag(slope) gather^T gather diag(slope) weights x, [S, 3]."""
    for r in range(first, end):
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


@kernel(error_model="numpy")
def _to_anchors(
    first: int,
    end: int,
    indptr: NDArray[np.int64],
    indices: NDArray[np.int32],
    values: Float32Array,
    samples: Float32Array,
    x: Float32Array,
    damping: float,
    out: Float32Array,
) -> None:
    """weights^T samples + damping x, [N, 3]."""
    keep = np.float32(damping)
    for j in range(first, end):
        a, b, c = np.float32(0), np.float32(0), np.float32(0)
        if keep > 0:
            a, b, c = keep * x[j, 0], keep * x[j, 1], keep * x[j, 2]
        for k in range(indptr[j], indptr[j + 1]):
            w, s = values[k], indices[k]
            a += w * samples[s, 0]
            b += w * samples[s, 1]
            c += w * samples[s, 2]
        out[j, 0], out[j, 1], out[j, 2] = a, b, c


@kernel(error_model="numpy")
def _diagonal(
    first: int,
    end: int,
    indptr: NDArray[np.int64],
    indices: NDArray[np.int32],
    values: Float32Array,
    scale: Float32Array,
    damping: float,
    out: Float32Array,
) -> None:
    for j in range(first, end):
        for c in range(3):
            total = np.float32(damping)
            for k in range(indptr[j], indptr[j + 1]):
                through = values[k] * scale[indices[k], c]
                total += through * through
            out[j, c] = total
