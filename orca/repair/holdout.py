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


def foretold_share(
    rgb: Float32Array,
    inverse_depth: Float32Array,
    trusted: BoolArray,
    hole: BoolArray,
    rules: ExemplarRules,
    inner: float,
    outer: float,
) -> float:
    """The share of the structure's departure from a membrane that reproduces a hidden band best, 0 to 1.

    The band is as wide as the hole is thick to its middle, since so far the structure will be continued. The share is
    the least-squares weight of ``structure - membrane`` for ``truth - membrane`` over the band.

    Args:
        rgb: colours, [h, w, 3]; read where trusted.
        inverse_depth: [h, w]; read where trusted.
        trusted: background pixels, [h, w].
        hole: the component, [h, w].
        rules: patch size and averaging.
        inner: trusted pixels begin this far from the hole, in pixels.
        outer: the membrane's donors end this far from what it fills, in pixels; half of it bounds the band's width.

    Returns:
        0 where there is nothing to ask: too little background, or no departure.
    """
    thickness = float(cv2.distanceTransform(np.pad(hole, 1).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5).max())
    width = min(max(_LEAST_WIDTH, thickness), 0.5 * outer)
    distance = cv2.distanceTransform((~hole).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5)
    band = trusted & (distance < inner + width)
    beyond = trusted & ~band
    donors = beyond & (distance <= outer + width)
    if np.count_nonzero(band) < _LEAST_PIXELS or not donors.any():
        return 0.0
    made = continue_structure(rgb, inverse_depth, beyond, band, rules)
    if made is None:
        return 0.0
    reached = band & made[2]
    smooth = membrane(rgb, donors)[reached]
    departure, truth = made[0][reached] - smooth, rgb[reached] - smooth
    energy = float(np.square(departure).sum())
    return float(np.clip((departure * truth).sum() / energy, 0.0, 1.0)) if energy > 0 else 0.0
