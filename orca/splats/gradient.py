"""Loss of a splat picture against a target, and its gradient: one compiled sweep over the pixels.

The picture is linear in the colours; for alpha_k the gradient is T_k (r.c_k) - (sum of what lies behind) /
(1 - alpha_k), so one walk back to front through a pixel's splats is enough (Kerbl et al. 2023).
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from orca.camera import Camera
from orca.conventions import Float32Array, Float64Array
from orca.splats.model import Splats
from orca.splats.raster import DILATION, MAX_ALPHA, MIN_ALPHA, project, rasterise
from orca.threads import kernel

__all__ = ["Footprints", "footprints", "loss_and_gradient"]

_BANDS = 4  # each band of rows sums into arrays of its own: the same sum whatever the number of threads
_COLUMNS = 5  # gradient of red, green, blue, opacity, log growth


@dataclass(frozen=True, eq=False)
class Footprints:
    """One view of splats whose sizes may still change.

    Attributes:
        start: first row of each pixel, [P + 1] int64.
        splat: splat of each row, front to back, int32.
        centre: pixel positions, [N, 2] float32.
        covariance: projected covariance before dilation, as (xx, xy, yy), [N, 3] float32.
        width: pixels in a row.
    """

    start: NDArray[np.int64]
    splat: NDArray[np.int32]
    centre: Float32Array
    covariance: Float32Array
    width: int


def footprints(splats: Splats, camera: Camera, max_growth: float) -> Footprints:
    """Who may be seen where in a view, up to ``max_growth`` times the size that the splats have now."""
    hits = rasterise(splats.grown(np.full(len(splats), np.log(max_growth), np.float32)), camera)
    centre, conic, _ = project(splats, camera)
    det = conic[:, 0] * conic[:, 2] - conic[:, 1] ** 2
    covariance = np.stack([conic[:, 2] / det - DILATION, -conic[:, 1] / det, conic[:, 0] / det - DILATION], axis=1)
    return Footprints(hits.start, hits.splat, centre.astype(np.float32), covariance.astype(np.float32), camera.width)


def loss_and_gradient(
    view: Footprints,
    target: Float32Array,
    colours: Float32Array,
    opacities: Float32Array,
    growth: Float32Array,
) -> tuple[float, Float32Array]:
    """Sum of squared differences to a picture, and its gradient.

    Args:
        view: footprints.
        target: rgb over black, and alpha, [P, 4].
        colours: [N, 3].
        opacities: alpha at the centre, [N].
        growth: logarithm of each splat's size over that in ``view``, [N].

    Returns:
        The loss and [N, 5]: half the gradient for red, green, blue, opacity and growth.
    """
    footprint = (view.start, view.splat, view.centre, view.covariance, view.width)
    losses, parts = np.zeros(_BANDS), np.zeros((_BANDS, len(colours), _COLUMNS), np.float32)
    _sweep(_BANDS, *footprint, target, colours, opacities, growth, losses, parts)
    return float(losses.sum()), parts.sum(axis=0)


@numba.njit(cache=True, inline="always", fastmath=True)  # type: ignore[untyped-decorator]
def _falloff(covariance: Float32Array, growth: float, dx: float, dy: float) -> tuple[float, float]:
    """exp(-m2 / 2) of a pixel offset, and half the derivative of -m2 by the logarithm of the size."""
    square = np.exp(np.float32(2) * growth)
    xx = covariance[0] * square + np.float32(DILATION)
    xy = covariance[1] * square
    yy = covariance[2] * square + np.float32(DILATION)
    det = xx * yy - xy * xy
    qx, qy = (yy * dx - xy * dy) / det, (xx * dy - xy * dx) / det
    m2 = qx * dx + qy * dy
    return np.exp(np.float32(-0.5) * m2), m2 - np.float32(DILATION) * (qx * qx + qy * qy)


@kernel(fastmath=True)
def _sweep(
    first: int,
    last: int,
    start: NDArray[np.int64],
    splat: NDArray[np.int32],
    centre: Float32Array,
    covariance: Float32Array,
    width: int,
    target: Float32Array,
    colour: Float32Array,
    opacity: Float32Array,
    growth: Float32Array,
    losses: Float64Array,
    gradient: Float32Array,
) -> None:
    pixels = start.shape[0] - 1
    most = 0
    for p in range(pixels):
        most = max(most, start[p + 1] - start[p])
    for band in range(first, last):
        alpha, through = np.empty(most, np.float32), np.empty(most, np.float32)
        falloff, slope = np.empty(most, np.float32), np.empty(most, np.float32)
        grad = gradient[band]
        for p in range(band * pixels // _BANDS, (band + 1) * pixels // _BANDS):
            x, y = np.float32(p % width + 0.5), np.float32(p // width + 0.5)
            r0, r1, r2, left, n = -target[p, 0], -target[p, 1], -target[p, 2], np.float32(1), 0
            for k in range(start[p], start[p + 1]):
                i = splat[k]
                f, s = _falloff(covariance[i], growth[i], x - centre[i, 0], y - centre[i, 1])
                a = opacity[i] * f
                falloff[n], slope[n], through[n] = f, s, left
                if a > np.float32(MAX_ALPHA):  # clamped: nothing to gain from opacity or size
                    a, falloff[n], slope[n] = np.float32(MAX_ALPHA), np.float32(0), np.float32(0)
                if a < np.float32(MIN_ALPHA):
                    a = np.float32(0)
                alpha[n] = a
                r0 += left * a * colour[i, 0]
                r1 += left * a * colour[i, 1]
                r2 += left * a * colour[i, 2]
                left *= np.float32(1) - a
                n += 1
                if left < np.float32(1e-4):
                    break
            r3 = np.float32(1) - left - target[p, 3]
            losses[band] += r0 * r0 + r1 * r1 + r2 * r2 + r3 * r3
            behind = np.float32(0)
            for j in range(n - 1, -1, -1):
                if alpha[j] == 0:
                    continue
                i = splat[start[p] + j]
                weight = through[j] * alpha[j]
                grad[i, 0] += weight * r0
                grad[i, 1] += weight * r1
                grad[i, 2] += weight * r2
                along = r0 * colour[i, 0] + r1 * colour[i, 1] + r2 * colour[i, 2] + r3
                by_alpha = through[j] * along - behind / (np.float32(1) - alpha[j])
                behind += weight * along
                grad[i, 3] += by_alpha * falloff[j]
                grad[i, 4] += by_alpha * alpha[j] * slope[j]
