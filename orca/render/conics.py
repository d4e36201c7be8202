"""Screen-space form of the ray-Gaussian test for one pinhole camera (METHOD.md 5.1), compiled by numba.

For the pixel p, the ray is o + t M p~. With p_i the projection of the mean, t0 its depth, dp = p - p_i,
v = A M p~_i, V = A M[:, :2], E = V^T V, h = V^T v, a0 = v.v and Gamma = a0 E - h h^T:

    a(p)  = a0 + 2 h.dp + dp^T E dp
    m2(p) = t0^2 (dp^T Gamma dp) / a(p)
    t*(p) = t0 (a0 + h.dp) / a(p)

and m2 <= chi2 is the ellipse dp^T (t0^2 Gamma - chi2 E) dp - 2 chi2 h.dp - chi2 a0 <= 0. This re-centred form keeps
float32 results exact to 1e-6; the textbook c - b^2/a does not.

An ellipsoid that reaches the plane at depth ``near`` has no ellipse that says it all (past the camera's own plane the
outline is a hyperbola); it is rare, and tested pixel by pixel.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orca.conventions import Float32Array, Float64Array
from orca.threads import kernel

__all__ = ["NUM_CONIC", "project_anchors"]

# Columns of the conic table: projection (2), t0, a0, h (2), E (3), Gamma (3), 1 if it reaches `near`; all float64.
NUM_CONIC = 13


def project_anchors(
    means: Float32Array,  # [N, 3]
    whitening: Float32Array,  # [N, 3, 3]
    pose: Float64Array,  # [4, 4] world to camera
    K: Float64Array,  # [3, 3]
    pixel_to_ray: Float64Array,  # [3, 3]
    size: tuple[int, int],  # width, height
    chi2: float,
    near: float,
) -> tuple[Float64Array, NDArray[np.int32], NDArray[np.uint8]]:
    """Conic table [N, 13], pixel boxes [N, 4] (x0, y0, x1, y1; empty when x1 <= x0); 1 where the camera is inside."""
    n = len(means)
    conic, box, inside = np.empty((n, NUM_CONIC)), np.zeros((n, 4), np.int32), np.zeros(n, np.uint8)
    _project(n, means, whitening, pose, K, pixel_to_ray, size, chi2, near, conic, box, inside)
    return conic, box, inside


@kernel()
def _project(
    first: int,
    end: int,
    means: Float32Array,
    whitening: Float32Array,
    pose: Float64Array,
    K: Float64Array,
    pixel_to_ray: Float64Array,
    size: tuple[int, int],
    chi2: float,
    near: float,
    conic: Float64Array,
    box: NDArray[np.int32],
    inside: NDArray[np.uint8],
) -> None:
    width, height = size
    for i in range(first, end):
        mx, my, mz = float(means[i, 0]), float(means[i, 1]), float(means[i, 2])
        cx = pose[0, 0] * mx + pose[0, 1] * my + pose[0, 2] * mz + pose[0, 3]
        cy = pose[1, 0] * mx + pose[1, 1] * my + pose[1, 2] * mz + pose[1, 3]
        t0 = pose[2, 0] * mx + pose[2, 1] * my + pose[2, 2] * mz + pose[2, 3]
        if not t0 > near:  # written so that a NaN is left out too
            continue
        px = (K[0, 0] * cx + K[0, 1] * cy + K[0, 2] * t0) / t0
        py = (K[1, 1] * cy + K[1, 2] * t0) / t0
        a0, h0, h1, e00, e01, e11 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for r in range(3):
            w0, w1, w2 = float(whitening[i, r, 0]), float(whitening[i, r, 1]), float(whitening[i, r, 2])
            v0 = w0 * pixel_to_ray[0, 0] + w1 * pixel_to_ray[1, 0] + w2 * pixel_to_ray[2, 0]
            v1 = w0 * pixel_to_ray[0, 1] + w1 * pixel_to_ray[1, 1] + w2 * pixel_to_ray[2, 1]
            v2 = w0 * pixel_to_ray[0, 2] + w1 * pixel_to_ray[1, 2] + w2 * pixel_to_ray[2, 2]
            v = v0 * px + v1 * py + v2
            a0 += v * v
            h0 += v0 * v
            h1 += v1 * v
            e00 += v0 * v0
            e01 += v0 * v1
            e11 += v1 * v1
        g00, g01, g11 = a0 * e00 - h0 * h0, a0 * e01 - h0 * h1, a0 * e11 - h1 * h1
        row = (px, py, t0, a0, h0, h1, e00, e01, e11, g00, g01, g11, 0.0)
        for c in range(NUM_CONIC):
            conic[i, c] = row[c]
        if not t0 * t0 * a0 > chi2:
            inside[i] = 1
            continue
        # The ellipsoid's nearest depth is t0 - sqrt(chi2 var_z), with var_z = a0 det E / det Gamma.
        reaches_near = (t0 - near) ** 2 * (g00 * g11 - g01 * g01) <= chi2 * a0 * (e00 * e11 - e01 * e01)
        b00, b01, b11 = t0 * t0 * g00 - chi2 * e00, t0 * t0 * g01 - chi2 * e01, t0 * t0 * g11 - chi2 * e11
        det = b00 * b11 - b01 * b01
        if reaches_near or not (b00 > 0.0 and det > 0.0):
            conic[i, NUM_CONIC - 1] = 1.0
            box[i, 2], box[i, 3] = width, height
            continue
        ox = chi2 * (b11 * h0 - b01 * h1) / det
        oy = chi2 * (b00 * h1 - b01 * h0) / det
        reach = chi2 * (a0 + h0 * ox + h1 * oy)
        if not reach > 0.0:
            continue
        rx, ry = np.sqrt(reach * b11 / det), np.sqrt(reach * b00 / det)
        # Pixel x covers the centre x + 0.5; clamp in float, since a grazing ellipse may be wider than any int32.
        box[i, 0] = int(np.ceil(min(max(px + ox - rx - 0.5, 0.0), float(width))))
        box[i, 2] = int(np.floor(min(max(px + ox + rx - 0.5, -1.0), width - 1.0))) + 1
        box[i, 1] = int(np.ceil(min(max(py + oy - ry - 0.5, 0.0), float(height))))
        box[i, 3] = int(np.floor(min(max(py + oy + ry - 0.5, -1.0), height - 1.0))) + 1
