"""Forward warping of RGB-D: nearest point splats with a z-buffer, and which input pixels a view surely sees."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from orca.camera import Camera
from orca.conventions import PIXEL_CENTRE, Float32Array, Float64Array, UInt8Array
from orca.errors import BadInput

__all__ = ["Projection", "Splat", "depth_edges", "forward_splat", "project_depth", "sure_points"]


@dataclass(frozen=True, eq=False)
class Projection:
    """Where every pixel of a depth image falls in another view.

    Attributes:
        pixels: exact positions (x, y) in the target, [n, 2] float64, n = source height * width; NaN where not usable.
        z: z-depth in the target camera, [n] float64; NaN where not usable.
        index: flat target pixel, [n] int64; -1 for a point behind the camera, outside the frame or without a depth.
    """

    pixels: Float64Array
    z: Float64Array
    index: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Splat:
    """A forward-warped image.

    Attributes:
        rgb: [H, W, 3] uint8, black at holes.
        depth: z-depth of the winning point, [H, W] float32, infinite at holes.
        hit: [H, W] bool, pixels that at least one point reaches.
        source: flat source pixel of the winning point, [H, W] int64, -1 at holes.
    """

    rgb: UInt8Array
    depth: Float32Array
    hit: NDArray[np.bool_]
    source: NDArray[np.int64]


def project_depth(depth: Float32Array, source: Camera, target: Camera) -> Projection:
    """Project every pixel centre of a depth image into another camera.

    Args:
        depth: z-depth in the source camera, [H, W]; points that are not finite and positive are dropped.
        source: camera of the depth image, of its size.
        target: camera to project into.

    Raises:
        BadInput: the depth is not of the source camera's size.
    """
    _check_size("depth", depth.shape, source)
    flat = np.ascontiguousarray(depth, np.float64).ravel()
    H, offset = _relative(source, target)
    pixels, z = np.empty((flat.size, 2)), np.empty(flat.size)
    index = np.empty(flat.size, np.int64)
    _project(flat, source.width, H, offset, (target.width, target.height), pixels, z, index)
    return Projection(pixels, z, index)


def forward_splat(image: UInt8Array, depth: Float32Array, source: Camera, target: Camera) -> Splat:
    """Warp an RGB-D image into another camera: each pixel lands on its nearest target pixel, the nearest point wins.

    One pixel is one point: where the view magnifies, cracks stay open (they are holes). Equal depths go to the first
    source pixel in row-major order, so the result does not depend on the sort.

    Args:
        image: [H, W, 3] uint8 at the source camera.
        depth: z-depth, [H, W], in the units of the poses.
        source: camera of the image.
        target: camera to render.

    Raises:
        BadInput: image or depth are not of the source camera's size.
    """
    _check_size("image", image.shape[:2], source)
    winner = _z_buffer(project_depth(depth, source, target), target)
    hit = winner.source >= 0
    rgb = np.zeros((target.height, target.width, 3), np.uint8)
    rgb[hit] = image.reshape(-1, 3)[winner.source[hit]]
    return Splat(rgb, winner.depth, hit, winner.source)


def sure_points(
    depth: Float32Array,
    source: Camera,
    target: Camera,
    *,
    window: int = 5,
    depth_tolerance: float = 0.02,
    edge_ratio: float = 1.05,
) -> tuple[NDArray[np.bool_], Projection]:
    """Say which input pixels a target view surely shows.

    A point is sure if it falls at least one pixel inside the target frame, no splat within ``window`` pixels lies in
    front of it by more than ``depth_tolerance`` (the window closes the cracks through which a background point would
    leak between foreground points), and its 3x3 neighbourhood in the input spans less than ``edge_ratio`` in depth
    (at a depth edge nobody knows which side a pixel's colour belongs to).

    Args:
        depth: z-depth of the input, [H, W].
        source: the input camera.
        target: the novel view.
        window: side of the occlusion window in target pixels, odd.
        depth_tolerance: relative depth difference that still counts as the same surface.
        edge_ratio: largest ratio of depths within 3x3 input pixels.

    Returns:
        [n] bool over the input pixels in row-major order, and the projection.
    """
    projection = project_depth(depth, source, target)
    front = _local_minimum(_z_buffer(projection, target).depth, window).ravel()
    sure = ~depth_edges(depth, edge_ratio).ravel()
    _drop_unsure(projection.pixels, projection.z, projection.index, front, target.width, depth_tolerance, sure)
    return sure, projection


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _drop_unsure(
    pixels: Float64Array,
    z: Float64Array,
    index: NDArray[np.int64],
    front: Float32Array,
    width: int,
    tolerance: float,
    sure: NDArray[np.bool_],
) -> None:
    """Clear ``sure`` where a point is hidden by ``front``, or less than a pixel from the frame's border."""
    height = len(front) // width
    for i in range(len(sure)):
        x, y = pixels[i, 0], pixels[i, 1]
        if (
            index[i] < 0
            or not (1 <= x <= width - 1 and 1 <= y <= height - 1)
            or z[i] > np.float64(front[index[i]]) * (1.0 + tolerance)
        ):
            sure[i] = False


def depth_edges(depth: Float32Array, ratio: float) -> NDArray[np.bool_]:
    """Pixels [H, W] whose 3x3 neighbourhood spans more than ``ratio`` in depth, or holds an unusable depth.

    Unusable is what is not finite and positive.
    """
    usable = np.isfinite(depth) & (depth > 0)
    kernel = np.ones((3, 3), np.uint8)
    far = cv2.dilate(np.where(usable, depth, np.inf).astype(np.float32), kernel)
    near = cv2.erode(np.where(usable, depth, 0.0).astype(np.float32), kernel)
    return np.asarray(~(far < near * ratio))


def _relative(source: Camera, target: Camera) -> tuple[Float64Array, Float64Array]:
    """H [3, 3] and b [3] that give the homogeneous target pixel of a source pixel: z_source H (x, y, 1) + b.

    The same as unprojecting and projecting, but faster: H = K_t R K_s^-1 and b = K_t t of the relative pose.
    """
    rotation = target.rotation @ source.rotation.T
    H = target.K @ rotation @ np.linalg.inv(source.K)
    return H, target.K @ (target.translation - rotation @ source.translation)


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _project(
    depth: Float64Array,
    width: int,
    H: Float64Array,
    b: Float64Array,
    size: tuple[int, int],
    pixels: Float64Array,
    z: Float64Array,
    index: NDArray[np.int64],
) -> None:
    """Fill the arrays of a `Projection`; ``size`` is the target's."""
    for i in range(len(depth)):
        x, y, d = i % width + PIXEL_CENTRE, i // width + PIXEL_CENTRE, depth[i]
        w = d * (H[2, 0] * x + (H[2, 1] * y + H[2, 2])) + b[2]
        if not (0 < d < np.inf and w > 0):
            pixels[i, 0] = pixels[i, 1] = z[i] = np.nan
            index[i] = -1
            continue
        u = (d * (H[0, 0] * x + (H[0, 1] * y + H[0, 2])) + b[0]) / w
        v = (d * (H[1, 0] * x + (H[1, 1] * y + H[1, 2])) + b[1]) / w
        pixels[i, 0], pixels[i, 1], z[i] = u, v, w
        inside = 0 <= u < size[0] and 0 <= v < size[1]
        # Pixel i covers [i, i + 1): with centres at +0.5, the nearest pixel is the floor of the position.
        index[i] = int(v) * size[0] + int(u) if inside else -1


@dataclass(frozen=True, eq=False)
class _Winner:
    depth: Float32Array
    source: NDArray[np.int64]


def _z_buffer(projection: Projection, target: Camera) -> _Winner:
    """Nearest point per target pixel, ties to the first source pixel."""
    nearest = np.full(target.height * target.width, np.inf)
    source = np.full(nearest.shape, -1, np.int64)
    _keep_nearest(projection.z, projection.index, nearest, source)
    shape = (target.height, target.width)
    return _Winner(nearest.astype(np.float32).reshape(shape), source.reshape(shape))


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _keep_nearest(z: Float64Array, index: NDArray[np.int64], nearest: Float64Array, source: NDArray[np.int64]) -> None:
    for i in range(len(index)):
        cell = index[i]
        if cell >= 0 and z[i] < nearest[cell]:
            nearest[cell], source[cell] = z[i], i


def _local_minimum(depth: Float32Array, window: int) -> Float32Array:
    """Minimum over a square window, holes (infinite) ignored."""
    return np.asarray(cv2.erode(depth, np.ones((window, window), np.uint8)), np.float32)


def _check_size(what: str, shape: tuple[int, ...], camera: Camera) -> None:
    if tuple(shape) != (camera.height, camera.width):
        raise BadInput(
            f"{what} of shape {tuple(shape)} for a camera of {camera.width}x{camera.height} pixels",
            f"shape ({camera.height}, {camera.width})",
            "resize the image or the camera (Camera.resized)",
        )
