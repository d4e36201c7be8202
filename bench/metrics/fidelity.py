"""Comparing two images of one view: MSE, PSNR, SSIM, and the one rule for images of different size."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from orca.conventions import PIXEL_CENTRE, Float32Array, Float64Array, UInt8Array
from orca.errors import BadInput

__all__ = [
    "PSNR_VARIANT",
    "RESIZE_RULE",
    "SSIM_VARIANT",
    "SSIM_WINDOW",
    "mean_squared_error",
    "psnr_of_mse",
    "read_at",
    "resize_to",
    "ssim",
    "ssim_inside",
]

PSNR_VARIANT = "MSE over all pixels and channels, peak 255"
RESIZE_RULE = "another size: resized to the reference's (area when smaller, cubic when larger)"
SSIM_WINDOW = 7
SSIM_VARIANT = "uniform 7x7 window, sample covariance, K 0.01/0.03, range 255, mean over RGB"
# Positions are read in rows of this many: OpenCV's maps are images of at most 32767 a side.
READ_ROW = 4096


def mean_squared_error(image: UInt8Array, reference: UInt8Array, mask: NDArray[np.bool_] | None = None) -> float:
    """Mean squared difference in 0..255, over all channels of all pixels, or of those in ``mask``.

    Args:
        image: [H, W, 3] uint8.
        reference: [H, W, 3] uint8.
        mask: [H, W] bool, pixels to compare; must hold at least one.

    Raises:
        BadInput: shapes differ, or nothing is left to compare.
    """
    _check_pair(image, reference)
    difference = image.astype(np.float64) - reference
    chosen = difference if mask is None else difference[mask]
    if chosen.size == 0:
        raise BadInput("no pixel to compare", "at least one pixel", "check the mask")
    return float(np.mean(chosen**2))


def psnr_of_mse(mse: float) -> float:
    """Peak signal-to-noise ratio in dB for a peak of 255; infinite for 0."""
    return math.inf if mse == 0 else 10.0 * math.log10(255.0**2 / mse)


def ssim(image: UInt8Array, reference: UInt8Array) -> float:
    """Structural similarity (Wang et al. 2004) as scikit-image computes it; see `SSIM_VARIANT`.

    Args:
        image: [H, W, 3] uint8, both sides at least `SSIM_WINDOW` pixels.
        reference: [H, W, 3] uint8.

    Raises:
        BadInput: shapes differ, or the image is smaller than the window.
    """
    return float(_ssim_map(image, reference).mean(dtype=np.float64))


def ssim_inside(image: UInt8Array, reference: UInt8Array, mask: NDArray[np.bool_]) -> float | None:
    """Mean of the SSIM map over the pixels of ``mask``: masked inside the mean, the images stay whole.

    Painting the pixels outside the mask in one colour and taking the SSIM of that would count them as equal, and would
    put an edge into every window on the rim of the mask.

    Args:
        image: [H, W, 3] uint8, both sides at least `SSIM_WINDOW` pixels.
        reference: [H, W, 3] uint8.
        mask: [H, W] bool; a pixel counts where its whole window lies in the image.

    Returns:
        The mean, or None where no pixel counts.

    Raises:
        BadInput: shapes differ, or the image is smaller than the window.
    """
    here = _ssim_map(image, reference)
    border = SSIM_WINDOW // 2
    inner = mask[border : mask.shape[0] - border, border : mask.shape[1] - border]
    return float(here[inner].mean(dtype=np.float64)) if inner.any() else None


def read_at(image: UInt8Array | Float32Array, positions: Float64Array) -> Float32Array:
    """Colours of an image [H, W, 3] at positions (x, y) [n, 2] (pixel centres at +0.5), bilinear, [n, 3] float32."""
    count = len(positions)
    folded = np.zeros((max(1, -(-count // READ_ROW)) * READ_ROW, 2), np.float32)
    folded[:count] = positions - PIXEL_CENTRE  # OpenCV counts pixels from their centres
    grid = folded.reshape(-1, READ_ROW, 2)
    source = image.astype(np.float32, copy=False)
    colours = cv2.remap(source, grid[..., 0], grid[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(colours.reshape(-1, 3)[:count], np.float32)


def resize_to(image: UInt8Array, width: int, height: int) -> UInt8Array:
    """Bring an image to another size: area averaging when it shrinks, cubic interpolation when it grows.

    Raises `BadInput` for anything but uint8 [H, W, 3]: a cast of floats would be silent.
    """
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
        raise BadInput(f"an image {image.shape} {image.dtype}", "uint8 [H, W, 3]", "convert it first")
    if image.shape[:2] == (height, width):
        return image
    shrinks = image.shape[0] * image.shape[1] > width * height
    interpolation = cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(image, (width, height), interpolation=interpolation), np.uint8)


def _ssim_map(image: UInt8Array, reference: UInt8Array) -> Float64Array:
    """SSIM of every window that lies in the image, [H - 6, W - 6, 3]."""
    from skimage.metrics import structural_similarity

    _check_pair(image, reference)
    if min(image.shape[:2]) < SSIM_WINDOW:
        raise BadInput(
            f"an image of {image.shape[1]}x{image.shape[0]} pixels for SSIM",
            f"at least {SSIM_WINDOW} pixels a side",
            "use a larger image",
        )
    _, here = structural_similarity(image, reference, win_size=SSIM_WINDOW, channel_axis=2, data_range=255, full=True)
    border = SSIM_WINDOW // 2
    return np.asarray(here[border : here.shape[0] - border, border : here.shape[1] - border], np.float64)


def _check_pair(image: UInt8Array, reference: UInt8Array) -> None:
    fits = image.shape == reference.shape and image.ndim == 3 and image.shape[2] == 3
    if not fits or image.dtype != np.uint8 or reference.dtype != np.uint8:
        raise BadInput(
            f"images {image.shape} {image.dtype} and {reference.shape} {reference.dtype}",
            "two uint8 RGB images of one size",
            "resize or convert first",
        )
