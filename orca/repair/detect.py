"""Where a rendered view shows nothing: the disocclusion mask."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from orca.conventions import Float32Array
from orca.errors import BadInput
from orca.repair.components import BoolArray
from orca.repair.rules import RepairRules

__all__ = ["disocclusion_area", "disocclusion_mask", "mask_reach"]


def disocclusion_mask(alpha: Float32Array, depth: Float32Array, rules: RepairRules) -> BoolArray:
    """Pixels of a rendered view that no surface covers.

    A pixel is missing where its accumulated alpha is under ``rules.alpha_threshold``, or where its alpha or depth is
    not a number or its depth is not positive. A closing of radius ``rules.closing_radius`` then joins a sieve (the
    single missing pixels of a stretched surface) into one region; it adds the covered threads of up to two radii
    between missing pixels, which are too thin to be trusted as donors anyhow. Pixels within ``edge_reach`` of those
    that are not fully covered either (``edge_alpha``) belong to the region: half a rim over nothing is dark.

    Args:
        alpha: accumulated alpha, [H, W].
        depth: z-depth, [H, W].
        rules: thresholds.

    Returns:
        True where something is missing, [H, W].

    Raises:
        BadInput: the two arrays are not images of one size.
    """
    if alpha.ndim != 2 or alpha.shape != depth.shape or alpha.size == 0:
        raise BadInput(
            f"alpha of shape {alpha.shape} and depth of shape {depth.shape}", "two arrays [H, W]", "render both at once"
        )
    # "not (a >= b)" rather than "a < b": NaN counts as missing.
    covered = (alpha >= rules.alpha_threshold) & (depth > 0) & np.isfinite(depth)
    missing: NDArray[np.uint8] = (~covered).astype(np.uint8)
    if rules.closing_radius > 0:
        side = 2 * rules.closing_radius + 1
        missing = cv2.morphologyEx(missing, cv2.MORPH_CLOSE, np.ones((side, side), np.uint8)).astype(np.uint8)
    if rules.edge_reach > 0 and missing.any():
        side = 2 * rules.edge_reach + 1
        around = cv2.dilate(missing, np.ones((side, side), np.uint8)).astype(bool)
        missing |= (around & ~(alpha >= rules.edge_alpha)).astype(np.uint8)
    return missing.astype(bool)


def mask_reach(rules: RepairRules) -> int:
    """How far, in pixels, a change of coverage can change the mask: through the closing and the edge beside it."""
    return 2 * rules.closing_radius + rules.edge_reach


def disocclusion_area(mask: BoolArray, min_area: int = 1) -> int:
    """Missing pixels in components of at least ``min_area`` pixels: what ranks the views of a trajectory."""
    if not mask.any():
        return 0
    stats = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)[2]
    areas = stats[1:, cv2.CC_STAT_AREA]
    return int(areas[areas >= min_area].sum())
