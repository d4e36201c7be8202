"""Motorcycle, a Middlebury 2014 stereo pair with true disparity, as scikit-image ships it at a quarter of its size.

Calibration (scikit-image's docstring of ``stereo_motorcycle``): f 994.978 px, left principal point
(311.193, 254.877), right principal point 31.086 px further right, baseline 193.001 mm. A left pixel of disparity d is
seen at x - d on the same row of the right image, and z = f B / (d + 31.086). Disparities count from pixel to pixel, so
an offset common to both principal points (half a pixel or none) moves no correspondence.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.datasets.assemble import in_scene_radii
from bench.datasets.case import TrueView
from orca.camera import Camera
from orca.conventions import PIXEL_CENTRE, Float32Array, Float64Array, UInt8Array
from orca.images import load_image

__all__ = ["StereoCase", "fill_disparity", "read_motorcycle", "unreached"]

FOCAL_PX = 994.978
PRINCIPAL_POINT = (311.193, 254.877)
PRINCIPAL_SHIFT_PX = 31.086
BASELINE_MM = 193.001


@dataclass(frozen=True, eq=False)
class StereoCase:
    """The pair, with lengths in scene radii.

    Attributes:
        left: the input image, [H, W, 3] uint8.
        camera: the left camera, identity pose.
        depth: z-depth of the left image, [H, W] float32, filled where there is no truth.
        second: the right photograph with its own K.
        radius_mm: the scene radius R.
    """

    left: UInt8Array
    camera: Camera
    depth: Float32Array
    second: TrueView
    radius_mm: float


def read_motorcycle(left_file: Path, right_file: Path, disparity_file: Path) -> StereoCase:
    """Read the pair; raises `BadInput` for an image that cannot be read."""
    left, right = load_image(left_file), load_image(right_file)
    with np.load(disparity_file) as archive:
        disparity = fill_disparity(np.asarray(archive["arr_0"], np.float64))
    height, width = disparity.shape
    camera = Camera(_intrinsics(0.0), np.eye(4), width, height)
    depth_mm = (FOCAL_PX * BASELINE_MM / (disparity + PRINCIPAL_SHIFT_PX)).astype(np.float32)
    depth, radius_mm = in_scene_radii(depth_mm, camera)
    pose = np.eye(4)
    pose[0, 3] = -BASELINE_MM / radius_mm  # the right camera stands on the +x side
    second = TrueView(Camera(_intrinsics(PRINCIPAL_SHIFT_PX), pose, width, height), right, unreached(disparity))
    return StereoCase(left, camera, depth, second, radius_mm)


def _intrinsics(shift: float) -> Float64Array:
    x, y = PRINCIPAL_POINT
    return np.array([[FOCAL_PX, 0.0, x + shift], [0.0, FOCAL_PX, y], [0.0, 0.0, 1.0]])


def fill_disparity(disparity: Float64Array) -> Float64Array:
    """Give each pixel without truth (NaN or infinite; 7.3 % here) the value of the nearest pixel that has one.

    Nearest in the plane, not the farther neighbour on the row: a warp of the left image by the nearest fill comes
    0.5 dB closer to the right photograph.
    """
    from scipy import ndimage

    unknown = ~np.isfinite(disparity)
    nearest: NDArray[np.int64] = ndimage.distance_transform_edt(unknown, return_distances=False, return_indices=True)
    rows, columns = nearest
    return np.asarray(disparity[rows, columns], np.float64)


def unreached(disparity: Float64Array) -> NDArray[np.bool_]:
    """Pixels of the right image that no left pixel reaches in a nearest forward warp, [H, W] bool."""
    height, width = disparity.shape
    rows, columns = np.meshgrid(np.arange(height), np.arange(width), indexing="ij")
    target = np.floor(columns + PIXEL_CENTRE - disparity).astype(np.int64)
    inside = (target >= 0) & (target < width)
    hidden = np.ones((height, width), np.bool_)
    hidden[rows[inside], target[inside]] = False
    return hidden
