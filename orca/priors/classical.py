"""Inpainting by diffusion (OpenCV's two methods) and by the nearest known pixel."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from orca.conventions import Float32Array, to_float, to_uint8
from orca.priors.inpaint import InpaintFailed, check_hole, paste_hole

__all__ = ["NavierStokesInpainter", "NearestInpainter", "TeleaInpainter"]

_RADIUS = 3.0  # neighbourhood of both diffusion methods, in pixels


class TeleaInpainter:
    """Fast marching (Telea 2004), OpenCV's; works at 8 bits."""

    name = "telea"

    def inpaint(self, image: Float32Array, mask: NDArray[np.bool_]) -> Float32Array:
        """See `Inpainter`."""
        return _diffuse(image, mask, cv2.INPAINT_TELEA, self.name)


class NavierStokesInpainter:
    """Continued level lines (Bertalmio et al. 2001), OpenCV's; works at 8 bits."""

    name = "navier-stokes"

    def inpaint(self, image: Float32Array, mask: NDArray[np.bool_]) -> Float32Array:
        """See `Inpainter`."""
        return _diffuse(image, mask, cv2.INPAINT_NS, self.name)


class NearestInpainter:
    """Every hole pixel takes the colour of the nearest known pixel (Euclidean)."""

    name = "nearest"

    def inpaint(self, image: Float32Array, mask: NDArray[np.bool_]) -> Float32Array:
        """See `Inpainter`."""
        check_hole(image, mask)
        rows, columns = distance_transform_edt(mask, return_distances=False, return_indices=True)
        return paste_hole(image, mask, np.asarray(image[rows, columns], np.float32), self.name)


def _diffuse(image: Float32Array, mask: NDArray[np.bool_], method: int, name: str) -> Float32Array:
    """Only the hole's bounding box and what the method sees around it is worked on."""
    check_hole(image, mask)
    if not mask.any():
        return np.array(image, np.float32)
    window = _window(mask, margin=int(2 * _RADIUS) + 2)
    crop = np.where(mask[window][..., None], np.float32(0), image[window])
    try:
        filled = cv2.inpaint(to_uint8(crop), mask[window].astype(np.uint8), _RADIUS, method)
    except cv2.error as error:
        raise InpaintFailed(
            f"OpenCV's inpainting failed ({error.err})", "an image with a hole", "use another inpainter"
        ) from error
    result = np.array(image, np.float32)
    result[window] = paste_hole(image[window], mask[window], to_float(filled), name)
    return result


def _window(mask: NDArray[np.bool_], margin: int) -> tuple[slice, slice]:
    """Bounding box of the mask, grown by ``margin`` and cut at the border."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return (
        slice(max(0, int(rows[0]) - margin), int(rows[-1]) + margin + 1),
        slice(max(0, int(columns[0]) - margin), int(columns[-1]) + margin + 1),
    )
