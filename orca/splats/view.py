"""A view of splats: colour, coverage and depth, in no more memory than the image, however many splats overlap."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from orca.camera import Camera
from orca.conventions import Float32Array, Float64Array
from orca.splats.model import Splats
from orca.splats.raster import MAX_ALPHA, MIN_ALPHA, project, span
from orca.threads import kernel

__all__ = ["SplatView", "render_splats", "view_splats"]

_BAND_ROWS = 8
_STOP = 1e-4  # transmittance below which nothing more is composed


@dataclass(frozen=True, eq=False)
class SplatView:
    """One view.

    Attributes:
        rgb: over black, [H, W, 3] float32, may exceed 1.
        alpha: [H, W] float32 in [0, 1].
        depth: expected z-depth, 0 where alpha is 0, [H, W] float32.
    """

    rgb: Float32Array
    alpha: Float32Array
    depth: Float32Array


def view_splats(splats: Splats, camera: Camera) -> SplatView:
    """Render one view as public viewers draw it (see `orca.splats.raster`)."""
    pixels, conic, depth = project(splats, camera)
    with np.errstate(invalid="ignore", divide="ignore"):
        reach = 2.0 * np.log(splats.opacities.astype(np.float64) / MIN_ALPHA)
    order = _front_to_back(depth, reach, pixels, conic)
    bands = _bands(pixels, conic, reach, order, camera.width, camera.height)
    size = (camera.width, camera.height)
    out = np.zeros((camera.width * camera.height, 5), np.float32)
    _compose(len(bands[0]) - 1, pixels, conic, depth, reach, splats.opacities, splats.colours, bands, size, out)
    alpha = np.minimum(out[:, 3], 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        expected = np.where(alpha > 0, out[:, 4] / out[:, 3], 0).astype(np.float32)
    shape = (camera.height, camera.width)
    rgb = np.ascontiguousarray(out[:, :3]).reshape(*shape, 3)
    return SplatView(rgb, alpha.reshape(shape), expected.reshape(shape))


def render_splats(splats: Splats, camera: Camera, background: float = 0.0) -> Float32Array:
    """The picture alone, [H, W, 3] float32 in [0, 1], over a grey background."""
    view = view_splats(splats, camera)
    return np.clip(view.rgb + (1 - view.alpha[..., None]) * np.float32(background), 0, 1)


def _front_to_back(
    depth: Float64Array, reach: Float64Array, pixels: Float64Array, conic: Float64Array
) -> NDArray[np.int64]:
    """Splats that can be drawn, nearest first, equal depths in their own order."""
    drawn = np.isfinite(depth) & (reach > 0) & np.isfinite(pixels).all(axis=1) & np.isfinite(conic).all(axis=1)
    drawn &= conic[:, 0] * conic[:, 2] - conic[:, 1] ** 2 > 0
    kept = np.flatnonzero(drawn)
    return np.asarray(kept[np.argsort(depth[kept], kind="stable")])


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _bands(
    pixels: Float64Array,
    conic: Float64Array,
    reach: Float64Array,
    order: NDArray[np.int64],
    width: int,
    height: int,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Splats of each band of rows, nearest first: offsets [B + 1] and splat indices."""
    count = (height + _BAND_ROWS - 1) // _BAND_ROWS
    offset = np.zeros(count + 1, np.int64)
    member = np.empty(0, np.int64)
    cursor = offset[:-1].copy()
    for sweep in range(2):
        if sweep == 1:
            for b in range(count):
                offset[b + 1] += offset[b]
            member = np.empty(offset[count], np.int64)
            cursor = offset[:-1].copy()
        for i in order:
            a, b, c = conic[i]
            x0, x1 = span(pixels[i, 0], a, c, b, reach[i], width)
            y0, y1 = span(pixels[i, 1], c, a, b, reach[i], height)
            if x1 <= x0 or y1 <= y0:
                continue
            for band in range(y0 // _BAND_ROWS, (y1 - 1) // _BAND_ROWS + 1):
                if sweep == 0:
                    offset[band + 1] += 1
                else:
                    member[cursor[band]] = i
                    cursor[band] += 1
    return offset, member


@kernel()
def _compose(
    first: int,
    last: int,
    pixels: Float64Array,
    conic: Float64Array,
    depth: Float64Array,
    reach: Float64Array,
    opacity: Float32Array,
    colour: Float32Array,
    bands: tuple[NDArray[np.int64], NDArray[np.int64]],
    size: tuple[int, int],
    out: Float32Array,
) -> None:
    """Front-to-back composition, [P, 5] as rgb over black, accumulated alpha, and depth times alpha."""
    offset, member = bands
    width, height = size
    for band in range(first, last):
        top, bottom = band * _BAND_ROWS, min(height, (band + 1) * _BAND_ROWS)
        through = np.ones(((bottom - top) * width), np.float32)
        for k in range(offset[band], offset[band + 1]):
            i = member[k]
            a, b, c = conic[i]
            x0, x1 = span(pixels[i, 0], a, c, b, reach[i], width)
            y0, y1 = span(pixels[i, 1], c, a, b, reach[i], height)
            for y in range(max(y0, top), min(y1, bottom)):
                dy = y + 0.5 - pixels[i, 1]
                for x in range(x0, x1):
                    p = (y - top) * width + x
                    if through[p] < np.float32(_STOP):
                        continue
                    dx = x + 0.5 - pixels[i, 0]
                    m2 = a * dx * dx + 2 * b * dx * dy + c * dy * dy
                    if m2 > reach[i]:
                        continue
                    alpha = min(np.float32(MAX_ALPHA), opacity[i] * np.float32(np.exp(-0.5 * m2)))
                    weight = through[p] * alpha
                    row = out[y * width + x]
                    for channel in range(3):
                        row[channel] += weight * colour[i, channel]
                    row[3] += weight
                    row[4] += weight * np.float32(depth[i])
                    through[p] *= np.float32(1) - alpha
