"""Connected components of a disocclusion mask."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from orca.errors import BadInput

__all__ = ["Component", "connected_components"]

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Component:
    """One 8-connected missing region.

    Attributes:
        mask: the region inside its bounding box, [y1 - y0, x1 - x0] bool.
        bbox: (x0, y0, x1, y1) in pixels, the far ends excluded.
    """

    mask: BoolArray
    bbox: tuple[int, int, int, int]

    def __post_init__(self) -> None:
        x0, y0, x1, y1 = self.bbox
        if self.mask.shape != (y1 - y0, x1 - x0) or x0 < 0 or y0 < 0 or not self.mask.any():
            raise BadInput(
                f"component with a mask of shape {self.mask.shape} and bounding box {self.bbox}",
                "a non-empty mask that spans its bounding box (x0, y0, x1, y1)",
                "make components with connected_components",
            )

    @property
    def area(self) -> int:
        """Missing pixels."""
        return int(np.count_nonzero(self.mask))

    @property
    def fill(self) -> float:
        """Share of the bounding box that is missing, 0 to 1."""
        return self.area / self.mask.size

    @property
    def short_side(self) -> int:
        """Shorter side of the bounding box in pixels."""
        return min(self.bbox[2] - self.bbox[0], self.bbox[3] - self.bbox[1])

    def pixels(self) -> tuple[IntArray, IntArray]:
        """(y, x) of the missing pixels in the image, [area] each, in row-major order."""
        y, x = np.nonzero(self.mask)
        return y + self.bbox[1], x + self.bbox[0]

    def full_mask(self, height: int, width: int) -> BoolArray:
        """The region in the whole image, [height, width] bool."""
        full = np.zeros((height, width), bool)
        x0, y0, x1, y1 = self.bbox
        full[y0:y1, x0:x1] = self.mask
        return full


def connected_components(mask: BoolArray, min_area: int = 1, bridge: int = 0) -> list[Component]:
    """Split a mask [H, W] into its 8-connected components of at least ``min_area`` pixels.

    Args:
        mask: missing pixels.
        min_area: smaller components are left out.
        bridge: pieces up to this many pixels apart are one component: a silhouette tears into a dotted line, and each
            dot alone would be too small to repair and too many to repair one by one. The pixels between stay out.

    Returns:
        Largest first; equal areas from top to bottom, then from left to right.
    """
    labels, areas = _label(mask, bridge)
    boxes = _boxes(labels, len(areas))
    found: list[tuple[int, int, int, Component]] = []
    for label in np.flatnonzero(areas >= min_area):
        x0, y0, x1, y1 = (int(v) for v in boxes[label])
        crop = labels[y0:y1, x0:x1] == label + 1
        found.append((-int(areas[label]), y0, x0, Component(crop, (x0, y0, x1, y1))))
    # Where area and box corner are equal too, the label, in scan order, decides: the sort is stable.
    return [component for *_, component in sorted(found, key=lambda row: row[:3])]


def drop_small(mask: BoolArray, min_area: int, bridge: int = 0) -> BoolArray:
    """The mask [H, W] without the components that `connected_components` would leave out."""
    kept = mask.copy()
    if mask.any():
        # Labelling costs by the pixel: only the part that holds something is looked at.
        x, y, width, height = cv2.boundingRect(mask.view(np.uint8))
        inside = kept[y : y + height, x : x + width]
        label = _joined_labels(inside, bridge)[inside]
        inside[inside] = (np.bincount(label) >= min_area)[label]
    return kept


def _label(mask: BoolArray, bridge: int) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Label of each masked pixel from 1 (0: not masked) [H, W], and how many masked pixels have each [n]."""
    if mask.ndim != 2 or mask.dtype != np.bool_ or mask.size == 0:
        raise BadInput(
            f"mask of shape {mask.shape} and type {mask.dtype}", "a bool mask [H, W]", "see disocclusion_mask"
        )
    labels = np.asarray(_joined_labels(mask, bridge) * mask, np.int32)
    return labels, np.bincount(labels.ravel(), minlength=1)[1:].astype(np.int64)


def _joined_labels(mask: BoolArray, bridge: int) -> NDArray[np.int32]:
    """Label from 1 of each pixel of the mask, pieces up to ``bridge`` pixels apart joined, [H, W]."""
    joined = mask.astype(np.uint8)
    if bridge > 0:
        # Two pieces meet when each grows by half the gap.
        side = 2 * ((bridge + 1) // 2) + 1
        joined = cv2.dilate(joined, np.ones((side, side), np.uint8)).astype(np.uint8)
    return np.asarray(cv2.connectedComponents(joined, connectivity=8)[1], np.int32)


def _boxes(labels: NDArray[np.int32], count: int) -> NDArray[np.int64]:
    """Box (x0, y0, x1, y1) of each label from 1 on, [count, 4]."""
    y, x = np.nonzero(labels)
    which = labels[y, x] - 1
    boxes = np.empty((count, 4), np.int64)
    boxes[:, :2], boxes[:, 2:] = np.iinfo(np.int64).max, 0
    for column, values in ((0, x), (1, y)):
        np.minimum.at(boxes[:, column], which, values)
        np.maximum.at(boxes[:, column + 2], which, values + 1)
    return boxes
