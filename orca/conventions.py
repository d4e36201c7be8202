"""Axes, pixel centres, units and number formats: stated here once, used everywhere.

- Camera axes are OpenCV's: x right, y down, z forward. ``world_to_camera`` maps world points to camera points.
- The centre of the top-left pixel is at (0.5, 0.5); an image spans [0, width] x [0, height].
- Depth is z-depth (not ray length), positive, float32.
- Images are float32 RGB in [0, 1], HxWx3, inside the code; uint8 only at its edges.
- Quaternions are wxyz.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["PIXEL_CENTRE", "Float32Array", "Float64Array", "UInt8Array", "pixel_grid", "to_float", "to_uint8"]

PIXEL_CENTRE = 0.5

Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]
UInt8Array = NDArray[np.uint8]


def to_uint8(image: NDArray[np.floating]) -> UInt8Array:
    """Convert [0, 1] floats to 0..255, clipped and rounded half up (never truncated, never wrapped).

    NaN becomes 0, so that a broken pixel is black and not undefined.
    """
    scaled = np.nan_to_num(np.asarray(image, np.float32), nan=0.0, posinf=1.0, neginf=0.0)
    return (np.clip(scaled, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)


def to_float(image: UInt8Array) -> Float32Array:
    """Convert 0..255 to float32 [0, 1]."""
    return np.asarray(image, np.float32) / np.float32(255.0)


def pixel_grid(width: int, height: int) -> Float64Array:
    """Pixel centres of an image in row-major order, shape [height * width, 2] as (x, y)."""
    x, y = np.meshgrid(np.arange(width) + PIXEL_CENTRE, np.arange(height) + PIXEL_CENTRE)
    return np.stack([x.ravel(), y.ravel()], axis=1)
