"""Pictures and videos small enough to travel inside a page."""

from __future__ import annotations

import base64
import io
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from orca.conventions import Float32Array, UInt8Array
from orca.video import write_video

__all__ = ["FPS", "RUNGS", "Media", "depth_picture", "encode_video", "fitted", "webp"]

FPS = 10.0
# Longest side in pixels and H.264 constant rate factor of the videos: the first that fits the page is taken.
RUNGS = ((512, 25), (384, 26), (384, 30), (320, 32), (256, 34), (192, 36))
_KEY_EVERY = 10  # the page plays by jumping from frame to frame
_STILL_SIDE = 512
_QUALITY = 84


@dataclass
class Media:
    """Files inside the page.

    Attributes:
        items: (MIME type, base64) in the order of their ids, which are 0, 1, 2, ...
    """

    items: list[tuple[str, str]] = field(default_factory=list)

    def add(self, mime: str, content: bytes) -> int:
        """Keep a file; returns its id."""
        self.items.append((mime, base64.b64encode(content).decode("ascii")))
        return len(self.items) - 1


def fitted(image: UInt8Array, side: int) -> UInt8Array:
    """The image at most ``side`` pixels long, reduced by area averaging; smaller ones as they are."""
    height, width = image.shape[:2]
    scale = side / max(height, width)
    if scale >= 1:
        return image
    size = max(1, round(width * scale)), max(1, round(height * scale))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def webp(image: UInt8Array, side: int = _STILL_SIDE) -> bytes:
    """A WebP still of at most so many pixels a side."""
    from PIL import Image

    out = io.BytesIO()
    Image.fromarray(fitted(image, side)).save(out, "WEBP", quality=_QUALITY, method=4)
    return out.getvalue()


def depth_picture(depth: Float32Array) -> tuple[UInt8Array, float, float]:
    """Depth in colours, near bright and far dark, by inverse depth; and the depths of both ends.

    The ends are the 2nd and the 98th percentile. Where depth is not positive and finite the picture is black.
    """
    valid = np.isfinite(depth) & (depth > 0)
    if not valid.any():
        return np.zeros((*depth.shape, 3), np.uint8), float("nan"), float("nan")
    near, far = (float(value) for value in np.percentile(depth[valid], [2, 98]))
    inverse = 1 / np.where(valid, depth, far)
    share = np.clip((inverse - 1 / far) / max(1 / near - 1 / far, 1e-12), 0, 1)
    coloured = cv2.applyColorMap((share * 255).astype(np.uint8), cv2.COLORMAP_MAGMA)[..., ::-1]
    return np.where(valid[..., None], coloured, 0).astype(np.uint8), near, far


def encode_video(frames: Sequence[UInt8Array] | UInt8Array, side: int, crf: int) -> bytes:
    """Frames as an H.264 mp4 at `FPS`, at most ``side`` pixels long."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "video.mp4"
        write_video(path, (fitted(frame, side) for frame in frames), FPS, crf, _KEY_EVERY)
        return path.read_bytes()
