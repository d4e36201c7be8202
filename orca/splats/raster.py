"""Which pixels 3D Gaussian splats reach, as public viewers draw them; knows nothing of ORCA's own renderer.

EWA splatting (Zwicker et al. 2001) in the form of Kerbl et al. 2023: the covariance goes through the Jacobian of the
projection at the mean, 0.3 px^2 are added to its diagonal, splats are sorted by the depth of their means, and
alpha = min(0.99, o exp(-m2 / 2)) is composed front to back; contributions below 1/255 are left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from orca.camera import Camera
from orca.conventions import Float32Array, Float64Array
from orca.splats.model import Splats

__all__ = ["DILATION", "MAX_ALPHA", "MIN_ALPHA", "SplatHits", "project", "rasterise", "span"]

MAX_ALPHA = 0.99
MIN_ALPHA = 1 / 255
DILATION = 0.3  # px^2
_NEAR = 0.01
_FRUSTUM = 1.3  # the Jacobian is taken no farther outside than this share of the half field of view
_MAX_M2 = 2 * np.log(MAX_ALPHA / MIN_ALPHA)  # beyond it even an opaque splat is below 1/255


@dataclass(frozen=True, eq=False)
class SplatHits:
    """Which splats each pixel of one view sees, front to back.

    Attributes:
        start: first row of each pixel, [P + 1] int64.
        splat: splat index of each row, int32.
        falloff: exp(-m2 / 2) of each row, float32.
    """

    start: NDArray[np.int64]
    splat: NDArray[np.int32]
    falloff: Float32Array


def project(splats: Splats, camera: Camera) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Pixel positions [N, 2], inverse 2D covariances as (xx, xy, yy) [N, 3], and z-depths [N].

    A splat nearer than 0.01 gets depth infinity: it is not drawn.
    """
    local = splats.means.astype(np.float64) @ camera.rotation.T + camera.translation
    z = local[:, 2]
    drawn = z > _NEAR
    depth = np.where(drawn, z, 1.0)
    fx, fy = camera.K[0, 0], camera.K[1, 1]
    pixels = np.stack([local[:, 0] / depth * fx + camera.K[0, 2], local[:, 1] / depth * fy + camera.K[1, 2]], axis=1)
    half = _FRUSTUM * np.array([camera.width / (2 * fx), camera.height / (2 * fy)])
    slope = np.clip(local[:, :2] / depth[:, None], -half, half)
    jacobian = np.zeros((len(z), 2, 3))
    jacobian[:, 0, 0], jacobian[:, 0, 2] = fx / depth, -fx * slope[:, 0] / depth
    jacobian[:, 1, 1], jacobian[:, 1, 2] = fy / depth, -fy * slope[:, 1] / depth
    axes = (jacobian @ camera.rotation) @ splats.axes().astype(np.float64)
    cov = axes @ axes.transpose(0, 2, 1)
    xx, yy, xy = cov[:, 0, 0] + DILATION, cov[:, 1, 1] + DILATION, cov[:, 0, 1]
    det = xx * yy - xy * xy
    conic = np.stack([yy / det, -xy / det, xx / det], axis=1)
    return pixels, conic, np.where(drawn, z, np.inf)


def rasterise(splats: Splats, camera: Camera) -> SplatHits:
    """Hits of every pixel of a view, row by row. Does not depend on colours or opacities."""
    pixels, conic, depth = project(splats, camera)
    order = np.argsort(depth, kind="stable")
    order = order[: int(np.isfinite(depth).sum())].astype(np.int32)
    return SplatHits(*_hits(pixels, conic, order, camera.width, camera.height, float(_MAX_M2)))


@numba.njit(cache=True, inline="always")  # type: ignore[untyped-decorator]
def span(centre: float, own: float, other: float, cross: float, m2: float, size: int) -> tuple[int, int]:
    """First and past-the-end pixel whose centres the ellipse m2 spans along one axis."""
    half = np.sqrt(m2 * other / (own * other - cross * cross))
    low = min(max(centre - half - 0.5, 0.0), float(size))
    high = min(max(centre + half - 0.5, -1.0), size - 1.0)
    return int(np.ceil(low)), int(np.floor(high)) + 1


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _hits(
    pixels: Float64Array,
    conic: Float64Array,
    order: NDArray[np.int32],
    width: int,
    height: int,
    max_m2: float,
) -> tuple[NDArray[np.int64], NDArray[np.int32], Float32Array]:
    """Counted in one sweep, written in a second; both go front to back, so every pixel's rows are in order."""
    start = np.zeros(width * height + 1, np.int64)
    for sweep in range(2):
        if sweep == 1:
            for p in range(width * height):
                start[p + 1] += start[p]
            splat, falloff = np.empty(start[-1], np.int32), np.empty(start[-1], np.float32)
            cursor = start[:-1].copy()
        for i in order:
            a, b, c = conic[i, 0], conic[i, 1], conic[i, 2]
            x0, x1 = span(pixels[i, 0], a, c, b, max_m2, width)
            y0, y1 = span(pixels[i, 1], c, a, b, max_m2, height)
            for y in range(y0, y1):
                dy = y + 0.5 - pixels[i, 1]
                for x in range(x0, x1):
                    dx = x + 0.5 - pixels[i, 0]
                    m2 = a * dx * dx + 2 * b * dx * dy + c * dy * dy
                    if m2 > max_m2:
                        continue
                    p = y * width + x
                    if sweep == 0:
                        start[p + 1] += 1
                    else:
                        splat[cursor[p]], falloff[cursor[p]] = i, np.exp(-0.5 * m2)
                        cursor[p] += 1
    return start, splat, falloff
