"""RootSIFT features of the frames of a video, each frame detected once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass

import cv2
import numpy as np

from orca.conventions import PIXEL_CENTRE, Float32Array, Float64Array, UInt8Array
from orca.errors import BadInput

__all__ = ["Features", "SiftConfig", "detect", "detect_all"]


@dataclass(frozen=True)
class SiftConfig:
    """SIFT as COLMAP 3.7 runs it, in OpenCV's terms.

    Attributes:
        octave_layers: scales per octave.
        contrast_threshold: peak threshold; OpenCV divides it by ``octave_layers`` (0.02 / 3 in COLMAP).
        edge_threshold: largest edge response.
        sigma: blur of the first octave, pixels.
        max_keypoints: at most this many, those of larger scale first.
    """

    octave_layers: int = 3
    contrast_threshold: float = 0.02
    edge_threshold: float = 30.0
    sigma: float = 1.6
    max_keypoints: int = 8192


@dataclass(frozen=True, eq=False)
class Features:
    """Keypoints of one frame.

    Attributes:
        points: (x, y) in pixels, [n, 2] float64, pixel centres at +0.5.
        descriptors: RootSIFT, unit length, [n, 128] float32.
    """

    points: Float64Array
    descriptors: Float32Array

    def __len__(self) -> int:
        return len(self.points)


def detect(frame: UInt8Array, config: SiftConfig | None = None) -> Features:
    """Detect RootSIFT features (Lowe 2004; Arandjelovic & Zisserman 2012) on the grey version of a frame.

    Args:
        frame: RGB [H, W, 3] or grey [H, W], uint8.
        config: detector settings; the reference's when left out.

    Raises:
        BadInput: for another shape or type.
    """
    if frame.dtype != np.uint8 or frame.ndim not in (2, 3) or (frame.ndim == 3 and frame.shape[2] != 3):
        raise BadInput(f"a frame of shape {frame.shape}, {frame.dtype}", "uint8 [H, W, 3] or [H, W]", "convert it")
    c = config or SiftConfig()
    grey = cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY) if frame.ndim == 3 else frame
    # Without the precise upscale OpenCV's keypoints lie 0.25 px off: a 180-degree turn would show 0.50 px.
    sift = cv2.SIFT.create(
        nfeatures=0,
        nOctaveLayers=c.octave_layers,
        contrastThreshold=c.contrast_threshold,
        edgeThreshold=c.edge_threshold,
        sigma=c.sigma,
        enable_precise_upscale=True,
    )
    keypoints, raw = sift.detectAndCompute(np.ascontiguousarray(grey), None)
    if raw is None or len(keypoints) == 0:
        return Features(np.zeros((0, 2)), np.zeros((0, 128), np.float32))
    points = np.asarray(cv2.KeyPoint.convert(keypoints), np.float64).reshape(-1, 2) + PIXEL_CENTRE
    if len(points) > c.max_keypoints:
        size = np.array([keypoint.size for keypoint in keypoints])
        kept = np.sort(np.argsort(-size, kind="stable")[: c.max_keypoints])
        points, raw = points[kept], raw[kept]
    return Features(points, _root_sift(raw))


def detect_all(
    frames: Sequence[UInt8Array], config: SiftConfig | None = None, threads: int = 2
) -> tuple[Features, ...]:
    """Features of every frame, in order; frames are shared out over ``threads`` threads (OpenCV releases the GIL).

    The result does not depend on ``threads``.
    """
    with _opencv_single_threaded(), ThreadPoolExecutor(max_workers=max(1, threads)) as pool:
        return tuple(pool.map(lambda frame: detect(frame, config), frames))


def _root_sift(raw: Float32Array) -> Float32Array:
    total = np.maximum(raw.sum(axis=1, keepdims=True), np.finfo(np.float32).tiny)
    root = np.sqrt(raw / total)
    # Unit length up to rounding already; normalised again so that a dot product is a cosine.
    norm = np.maximum(np.linalg.norm(root, axis=1, keepdims=True), np.finfo(np.float32).tiny)
    return np.asarray(root / norm, np.float32)


@contextmanager
def _opencv_single_threaded() -> Iterator[None]:
    """OpenCV's own threads off: with one frame a thread they only get in each other's way."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)
