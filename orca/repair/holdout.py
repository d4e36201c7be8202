"""How far a texture can be foretold beside a hole: structure is continued into it to that extent and no further.

Patches that continue stripes or tiles beat a smooth membrane by decibels, and lose as much where what is hidden does
not follow from what is seen. Which of the two it is can be asked of pixels whose colours are known: a band along the
hole's background side is hidden, continued from what lies beyond it, and compared.
"""

from __future__ import annotations

import cv2
import numpy as np

from orca.conventions import Float32Array
from orca.repair.components import BoolArray
from orca.repair.membrane import membrane
from orca.repair.structure import ExemplarRules, continue_structure

__all__ = ["foretold_share"]

_LEAST_WIDTH = 3.0  # of the band, in pixels
_LEAST_PIXELS = 16  # of the band: fewer say nothing
_NEIGHBOURHOOD = 2.5  # standard deviation, in patch radii, of the window in which a share is told
_PRIOR = 0.03  # weight of the whole band's share, in windows full of its mean departure


def foretold_share(
    rgb: Float32Array,
    inverse_depth: Float32Array,
    trusted: BoolArray,
    hole: BoolArray,
    rules: ExemplarRules,
    inner: float,
    outer: float,
) -> Float32Array:
    """The share of the structure's departure from a membrane that reproduces a hidden band best, 0 to 1.

    The band is as wide as the hole is thick to its middle, since so far the structure will be continued. The share is
    the least-squares weight of ``structure - membrane`` for ``truth - membrane``, in a window around each pixel of the
    band: beside one hole, stripes can end where clutter begins. From the band it is continued into the hole.

    Args:
        rgb: colours, [h, w, 3]; read where trusted.
        inverse_depth: [h, w]; read where trusted.
        trusted: background pixels, [h, w].
        hole: the component, [h, w].
        rules: patch size and averaging.
        inner: trusted pixels begin this far from the hole, in pixels.
        outer: the membrane's donors end this far from what it fills, in pixels; half of it bounds the band's width.

    Returns:
        [h, w]; 0 where there is nothing to ask: too little background, or no departure.
    """
    nothing = np.zeros(hole.shape, np.float32)
    thickness = float(cv2.distanceTransform(np.pad(hole, 1).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5).max())
    width = min(max(_LEAST_WIDTH, thickness), 0.5 * outer)
    distance = cv2.distanceTransform((~hole).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5)
    band = trusted & (distance < inner + width)
    beyond = trusted & ~band
    donors = beyond & (distance <= outer + width)
    if np.count_nonzero(band) < _LEAST_PIXELS or not donors.any():
        return nothing
    made = continue_structure(rgb, inverse_depth, beyond, band, rules)
    if made is None:
        return nothing
    reached = band & made[2]
    smooth = membrane(rgb, donors)
    departure = np.where(reached[..., None], made[0] - smooth, np.float32(0))
    truth = np.where(reached[..., None], rgb - smooth, np.float32(0))
    energy, agreement = np.square(departure).sum(2), (departure * truth).sum(2)
    if not energy.any():
        return nothing
    share = _local_weight(energy, agreement, reached, _NEIGHBOURHOOD * rules.radius)
    return membrane(share[..., None], reached)[..., 0]


def _local_weight(energy: Float32Array, agreement: Float32Array, where: BoolArray, sigma: float) -> Float32Array:
    """``agreement / energy`` in a Gaussian window, drawn towards that of all of ``where``, 0 to 1, [h, w]."""

    def window(values: Float32Array) -> Float32Array:
        return np.asarray(cv2.GaussianBlur(values, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT), np.float32)

    total = float(energy.sum(dtype=np.float64))
    overall = min(1.0, max(0.0, float(agreement.sum(dtype=np.float64)) / total))
    prior = _PRIOR * total / np.count_nonzero(where) * float(window(where.astype(np.float32)).max())
    share = (window(agreement) + prior * overall) / (window(energy) + prior)
    return np.asarray(np.clip(share, 0.0, 1.0), np.float32)
