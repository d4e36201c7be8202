"""Closest approach of rays to anchors with its gradient, compiled: t*, m2 and a of every hit (METHOD.md 1, RIS).

With o = A (origin - mean), d = A direction and A = diag(exp(-s / 2)) R(q)^T:

    a = d.d,   t = -(o.d) / a,   c = o + t d,   m2 = c.c

and because c is orthogonal to d,

    do = 2 m2' c - (t' / a) d,   dd = 2 m2' t c - (t' / a) (o + 2 t d) + 2 a' d.

All in float64: m2 is a small difference of large numbers for thin anchors, and so is its gradient.
`closest_approach` is held to `eager_closest_approach`, the path of other devices, by tests.
"""

from __future__ import annotations

from dataclasses import replace

import numba
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd.function import FunctionCtx

from orca.anchors import GaussianAnchors
from orca.conventions import Float32Array, Float64Array

__all__ = ["closest_approach", "eager_closest_approach"]


def closest_approach(
    anchors: GaussianAnchors, origin: Tensor, directions: Tensor, anchor: Tensor, ray: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """t*, m2 and a of hits, each [H], differentiable in the anchors' means, extents and orientations.

    Compiled for float32 on the CPU; elsewhere `eager_closest_approach`.

    Args:
        anchors: those that the hits refer to.
        origin: of all rays, [3].
        directions: [R, 3], of any length.
        anchor: of each hit, [H] int64.
        ray: of each hit, [H] int64.
    """
    if anchors.means.device.type != "cpu" or anchors.means.dtype != torch.float32:
        return eager_closest_approach(anchors, origin, directions, anchor, ray)
    geometry = (anchors.means, anchors.log_variances, anchors.quaternions)
    t, m2, a = _ClosestApproach.apply(*geometry, origin, directions, anchor, ray)
    return t, m2, a


def eager_closest_approach(
    anchors: GaussianAnchors, origin: Tensor, directions: Tensor, anchor: Tensor, ray: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """The same in torch operations, on any device and in any precision."""
    exact = replace(
        anchors,
        means=anchors.means.double(),
        log_variances=anchors.log_variances.double(),
        quaternions=anchors.quaternions.double(),
    )
    whitening = exact.whitening()
    o = (whitening @ (origin - exact.means)[..., None])[..., 0].index_select(0, anchor)
    d = (whitening.index_select(0, anchor) @ directions.double().index_select(0, ray)[..., None])[..., 0]
    a = (d * d).sum(-1)
    t = -(o * d).sum(-1) / a
    closest = o + t[:, None] * d
    t, m2, a = (x.to(anchors.means.dtype) for x in (t, (closest * closest).sum(-1), a))
    return t, m2, a


class _ClosestApproach(torch.autograd.Function):
    @staticmethod
    def forward(ctx: FunctionCtx, *given: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        ctx.save_for_backward(*given)
        t, m2, a = _approach(*_arrays(given))
        return torch.from_numpy(t), torch.from_numpy(m2), torch.from_numpy(a)

    @staticmethod
    def backward(ctx: FunctionCtx, *grads: Tensor) -> tuple[Tensor | None, ...]:
        given = ctx.saved_tensors  # type: ignore[attr-defined]
        out = _gradient(*_arrays(given), *(grad.contiguous().numpy() for grad in grads))
        return (*(torch.from_numpy(grad) for grad in out), None, None, None, None)


def _arrays(given: tuple[Tensor, ...]) -> list[NDArray[np.generic]]:
    """Arrays of the arguments; origin and directions in float64."""
    anchors, rays, hits = given[:3], given[3:5], given[5:]
    return [x.detach().contiguous().numpy() for x in (*anchors, *(x.double() for x in rays), *hits)]


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _whitening(log_variances: Float32Array, quaternions: Float32Array) -> Float64Array:
    """A of every anchor, [N, 3, 3]."""
    out = np.empty((len(quaternions), 3, 3))
    for i in range(len(quaternions)):
        w, x, y, z = _unit(quaternions, i)
        rows = (
            (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
            (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
            (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
        )
        for r in range(3):
            scale = np.exp(-0.5 * np.float64(log_variances[i, r]))
            for c in range(3):
                out[i, r, c] = scale * rows[r][c]
    return out


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _length(quaternions: Float32Array, i: int) -> float:
    total = 0.0
    for k in range(4):
        total += np.float64(quaternions[i, k]) ** 2
    length: float = max(np.sqrt(total), 1e-12)  # as torch normalises
    return length


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _unit(quaternions: Float32Array, i: int) -> tuple[float, float, float, float]:
    per = 1 / _length(quaternions, i)
    return quaternions[i, 0] * per, quaternions[i, 1] * per, quaternions[i, 2] * per, quaternions[i, 3] * per


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _whitened(
    A: Float64Array, mean: Float32Array, origin: Float64Array, direction: Float64Array, o: Float64Array, d: Float64Array
) -> tuple[float, float]:
    """Set o and d of one hit; returns t and a."""
    a, od = 0.0, 0.0
    for r in range(3):
        o[r], d[r] = 0.0, 0.0
        for c in range(3):
            o[r] += A[r, c] * (origin[c] - mean[c])
            d[r] += A[r, c] * direction[c]
        a += d[r] * d[r]
        od += o[r] * d[r]
    return -od / a, a


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _approach(
    means: Float32Array,
    log_variances: Float32Array,
    quaternions: Float32Array,
    origin: Float64Array,
    directions: Float64Array,
    anchor: NDArray[np.int64],
    ray: NDArray[np.int64],
) -> tuple[Float32Array, Float32Array, Float32Array]:
    n, A = len(anchor), _whitening(log_variances, quaternions)
    t_out, m2_out, a_out = np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32)
    o, d = np.empty(3), np.empty(3)
    for h in range(n):
        i = anchor[h]
        t, a = _whitened(A[i], means[i], origin, directions[ray[h]], o, d)
        m2 = 0.0
        for r in range(3):
            m2 += (o[r] + t * d[r]) ** 2
        t_out[h], m2_out[h], a_out[h] = t, m2, a
    return t_out, m2_out, a_out


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _gradient(
    means: Float32Array,
    log_variances: Float32Array,
    quaternions: Float32Array,
    origin: Float64Array,
    directions: Float64Array,
    anchor: NDArray[np.int64],
    ray: NDArray[np.int64],
    t_grad: Float32Array,
    m2_grad: Float32Array,
    a_grad: Float32Array,
) -> tuple[Float32Array, Float32Array, Float32Array]:
    """Gradients of means, log-variances and quaternions; hits are added one after another, so it is repeatable."""
    A = _whitening(log_variances, quaternions)
    A_grad, mean_grad = np.zeros(A.shape), np.zeros(means.shape)
    o, d = np.empty(3), np.empty(3)
    for h in range(len(anchor)):
        i = anchor[h]
        direction = directions[ray[h]]
        t, a = _whitened(A[i], means[i], origin, direction, o, d)
        per_a = t_grad[h] / a
        for r in range(3):
            beside = 2 * m2_grad[h] * (o[r] + t * d[r])
            o_grad = beside - per_a * d[r]
            d_grad = t * beside - per_a * (o[r] + 2 * t * d[r]) + 2 * a_grad[h] * d[r]
            for c in range(3):
                A_grad[i, r, c] += o_grad * (origin[c] - means[i, c]) + d_grad * direction[c]
                mean_grad[i, c] -= A[i, r, c] * o_grad
    variance_grad, quaternion_grad = np.empty(means.shape, np.float32), np.empty(quaternions.shape, np.float32)
    for i in range(len(means)):
        for r in range(3):
            scale = np.exp(-0.5 * np.float64(log_variances[i, r]))
            total = 0.0
            for c in range(3):
                total += A_grad[i, r, c] * A[i, r, c]
                A_grad[i, r, c] *= scale  # now the gradient of R^T
            variance_grad[i, r] = -0.5 * total
        _rotation_gradient(A_grad[i], quaternions, i, quaternion_grad)
    return mean_grad.astype(np.float32), variance_grad, quaternion_grad


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _rotation_gradient(g: Float64Array, quaternions: Float32Array, i: int, out: Float32Array) -> None:
    """From the gradient g of R(q / |q|)^T to that of q."""
    w, x, y, z = _unit(quaternions, i)
    gw = 2 * (z * (g[0, 1] - g[1, 0]) + y * (g[2, 0] - g[0, 2]) + x * (g[1, 2] - g[2, 1]))
    gx = 2 * (y * (g[1, 0] + g[0, 1]) + z * (g[2, 0] + g[0, 2]) + w * (g[1, 2] - g[2, 1]) - 2 * x * (g[1, 1] + g[2, 2]))
    gy = 2 * (x * (g[1, 0] + g[0, 1]) + w * (g[2, 0] - g[0, 2]) + z * (g[2, 1] + g[1, 2]) - 2 * y * (g[0, 0] + g[2, 2]))
    gz = 2 * (w * (g[0, 1] - g[1, 0]) + x * (g[2, 0] + g[0, 2]) + y * (g[2, 1] + g[1, 2]) - 2 * z * (g[0, 0] + g[1, 1]))
    along, per = gw * w + gx * x + gy * y + gz * z, 1 / _length(quaternions, i)
    out[i, 0], out[i, 1] = (gw - along * w) * per, (gx - along * x) * per
    out[i, 2], out[i, 3] = (gy - along * y) * per, (gz - along * z) * per
