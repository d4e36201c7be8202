"""Image files in and out: whatever the file holds becomes [H, W, 3] uint8 RGB."""

from __future__ import annotations

import os
import struct
import warnings
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps, UnidentifiedImageError

from orca.atomic import atomic_path
from orca.conventions import UInt8Array
from orca.errors import BadInput

__all__ = ["MAX_PIXELS", "MIN_SIDE", "load_image", "save_image"]

MIN_SIDE = 16
MAX_PIXELS = 100_000_000
_FORMATS = "a PNG, JPEG, WebP, TIFF, BMP or GIF image"
# Pillow has dozens more, some of which start other programs (EPS: Ghostscript).
_DECODERS = ("PNG", "JPEG", "WEBP", "TIFF", "BMP", "GIF")
# What Pillow's decoders raise on broken data.
_BROKEN = (OSError, SyntaxError, ValueError, EOFError, struct.error, IndexError, KeyError, TypeError, OverflowError)


def load_image(path: str | os.PathLike[str]) -> UInt8Array:
    """Read an image file as [H, W, 3] uint8 RGB, turned upright by its EXIF orientation.

    Alpha is dropped: the stored colour under it is taken as it is. Grey, palette and CMYK become RGB. 16-bit grey is
    divided by 257 and rounded; of 16-bit colour Pillow keeps the high byte (both map k * 257 to k). Of an animation
    the first frame is read. Colour profiles are not applied.

    Raises:
        BadInput: no such file, not an image, truncated, a side under 16 px, or more than 100 megapixels.
    """
    source = Path(path)
    if not source.is_file():
        what = "is a folder" if source.is_dir() else "does not exist"
        raise BadInput(f"image file '{source}' {what}", _FORMATS, "check the path")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # our own limit is checked instead
            with Image.open(source, formats=_DECODERS) as image:
                _check_size(source, *image.size)
                upright = ImageOps.exif_transpose(image)
                return np.array(_to_rgb(source, upright))
    except BadInput:
        raise
    except Image.DecompressionBombError as error:
        raise _too_large(source, str(error)) from error
    except UnidentifiedImageError as error:
        raise BadInput(f"'{source}' is not an image", _FORMATS, "check that the file is what its name says") from error
    except _BROKEN as error:
        raise BadInput(f"'{source}' cannot be decoded ({error})", _FORMATS, "get the file again") from error


def save_image(path: str | os.PathLike[str], image: UInt8Array) -> None:
    """Write [H, W, 3] or [H, W] uint8 to an image file, atomically; the suffix chooses the format.

    Raises:
        BadInput: another shape or type, or a suffix that no image format has.
    """
    target, pixels = Path(path), np.asarray(image)
    if pixels.dtype != np.uint8 or not (pixels.ndim == 2 or (pixels.ndim == 3 and pixels.shape[2] == 3)):
        raise BadInput(
            f"pixels of shape {pixels.shape} and type {pixels.dtype}",
            "[H, W, 3] or [H, W] uint8",
            "convert with orca.conventions.to_uint8",
        )
    if target.suffix.lower() not in Image.registered_extensions():
        raise BadInput(f"image file name '{target.name}'", "a suffix such as .png or .jpg", "change the suffix")
    with atomic_path(target) as temporary:
        Image.fromarray(np.ascontiguousarray(pixels)).save(temporary)


def _check_size(source: Path, width: int, height: int) -> None:
    if width * height > MAX_PIXELS:
        raise _too_large(source, f"{width}x{height} pixels")
    if min(width, height) < MIN_SIDE:
        raise BadInput(
            f"image '{source}' of {width}x{height} pixels",
            f"at least {MIN_SIDE} pixels a side",
            "use a larger image: there is no scene to rebuild in this one",
        )


def _too_large(source: Path, size: str) -> BadInput:
    return BadInput(f"image '{source}': {size}", f"at most {MAX_PIXELS // 10**6} megapixels", "scale the image down")


def _to_rgb(source: Path, image: Image.Image) -> Image.Image:
    """8-bit RGB from any mode that Pillow opens."""
    if image.mode.startswith("I"):  # 16-bit grey; some files come as 32-bit "I" with 16-bit content
        grey = np.asarray(image).astype(np.int64)
        if grey.min() < 0 or grey.max() > 65535:
            raise BadInput(f"'{source}' holds 32-bit integers", "8 or 16 bits a channel", "convert it to 16 bits")
        return Image.fromarray(((grey + 128) // 257).astype(np.uint8)).convert("RGB")
    if image.mode == "F":
        raise BadInput(f"'{source}' holds floating-point values", "8 or 16 bits a channel", "convert it to 16 bits")
    if image.mode == "P":
        return image.convert("RGBA").convert("RGB")  # by way of RGBA: a transparency table warns otherwise
    return image.convert("RGB")
