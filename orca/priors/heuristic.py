"""Depth without a network: a guess, and it says so."""

from __future__ import annotations

import logging
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from orca.camera import Camera
from orca.conventions import Float32Array
from orca.priors.depth import DepthEstimate
from orca.priors.spec import PriorSpec

__all__ = ["ConstantDepth", "HeuristicDepth", "sky_mask"]

_log = logging.getLogger(__name__)

NEAR, FAR = 1.0, 3.0
HORIZON = 0.4  # of the height: photographs look slightly down more often than up
CEILING = 0.7  # how much nearer the top of an image comes, as a share of what the bottom does, when no sky is seen


@dataclass(frozen=True)
class HeuristicDepth:
    """``heuristic``: a room or a street seen from the middle, not this image.

    Inverse depth grows linearly from the horizon to the bottom (a ground plane) and, less, to the top (a ceiling;
    none where sky is seen). Sky is far. The sum is smoothed along the image's own edges (guided filter, He et al.
    2010) and lies in [1, 3]. It is not metric, and nothing that the picture shows is measured.
    """

    name: str = "heuristic"

    @classmethod
    def from_spec(cls, spec: PriorSpec) -> HeuristicDepth:
        """There are no options."""
        spec.allow()
        return cls()

    def estimate(self, image: Float32Array, camera: Camera) -> DepthEstimate:
        """See `DepthProvider`. Logs a warning: the geometry is guessed."""
        warning = "depth is guessed from a ground-plane prior, not estimated: give --depth for true geometry"
        _log.warning("%s", warning)
        pixels = np.asarray(image, np.float32)
        height, width = pixels.shape[:2]
        sky = sky_mask(pixels)
        nearness = np.repeat(_row_prior(height, float(sky.mean()))[:, None], width, axis=1)
        nearness = np.where(sky, np.float32(0), nearness)
        grey = cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY)
        smooth = np.clip(_guided_filter(grey, nearness, max(2, height // 32), 1e-3), 0.0, 1.0)
        depth = 1.0 / (1.0 / FAR + (1.0 / NEAR - 1.0 / FAR) * smooth)
        return DepthEstimate(
            np.clip(depth, NEAR, FAR).astype(np.float32), "heuristic (no network)", False, None, (warning,)
        )


@dataclass(frozen=True)
class ConstantDepth:
    """``constant``: a flat picture at z = 1 (or ``constant?z=2``), for tests and comparisons."""

    z: float = 1.0
    name: str = "constant"

    @classmethod
    def from_spec(cls, spec: PriorSpec) -> ConstantDepth:
        """Option ``z``."""
        spec.allow("z")
        return cls(spec.number("z", 1.0))

    def estimate(self, image: Float32Array, camera: Camera) -> DepthEstimate:
        """See `DepthProvider`."""
        depth = np.full(image.shape[:2], self.z, np.float32)
        return DepthEstimate(depth, f"constant {self.z:g}", False, None, ("the scene is a flat picture",))


def sky_mask(image: Float32Array) -> NDArray[np.bool_]:
    """Bright, smooth, blue or colourless regions that touch the top border, [H, W] bool.

    Args:
        image: [H, W, 3] float32 in [0, 1].
    """
    height, width = image.shape[:2]
    red, green, blue = image[..., 0], image[..., 1], image[..., 2]
    grey = cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY)
    size = 2 * max(1, min(height, width) // 128) + 1
    spread = cv2.blur(grey * grey, (size, size)) - cv2.blur(grey, (size, size)) ** 2
    smooth = spread < 0.03**2
    cool = (blue >= red - 0.02) & (green >= red - 0.02)  # rules out purple walls
    candidate = smooth & cool & (((blue > 0.45) & (grey > 0.35)) | (blue > np.maximum(0.3, red + 0.15)))
    opened = cv2.morphologyEx(candidate.astype(np.uint8), cv2.MORPH_OPEN, np.ones((size, size), np.uint8))
    _, labels = cv2.connectedComponents(opened, connectivity=4)
    top = labels[0]
    seeds, counts = np.unique(top[top > 0], return_counts=True)
    wide = seeds[counts >= 0.2 * width]  # a bright lamp or window that touches the border is no sky
    sky = np.isin(labels, wide)
    return np.asarray(sky if sky.mean() >= 0.05 else np.zeros_like(sky))


def _row_prior(height: int, sky_share: float) -> Float32Array:
    """Nearness in [0, 1] of each row: 0 at the horizon, 1 at the bottom."""
    y = (np.arange(height) + 0.5) / height
    ceiling = CEILING * max(0.0, 1.0 - sky_share / 0.1)
    below, above = (y - HORIZON) / (1 - HORIZON), ceiling * (HORIZON - y) / HORIZON
    return np.maximum(below, above).astype(np.float32)


def _guided_filter(guide: Float32Array, values: Float32Array, radius: int, epsilon: float) -> Float32Array:
    """Smooth ``values`` but keep edges that ``guide`` has too (He et al. 2010, grey guide); all [H, W]."""

    def mean(field: Float32Array) -> Float32Array:
        size = (2 * radius + 1, 2 * radius + 1)
        return np.asarray(cv2.blur(field, size, borderType=cv2.BORDER_REFLECT), np.float32)

    mean_guide, mean_values = mean(guide), mean(values)
    variance = mean(guide * guide) - mean_guide**2
    slope = (mean(guide * values) - mean_guide * mean_values) / (variance + epsilon)
    offset = mean_values - slope * mean_guide
    return np.asarray(mean(slope) * guide + mean(offset), np.float32)
