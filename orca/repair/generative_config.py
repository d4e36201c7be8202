"""The constants of generative repair (paper, "Disocclusion Repair" and "Implementation Details")."""

from __future__ import annotations

from dataclasses import dataclass, replace

from orca.errors import BadInput
from orca.repair.rules import REFERENCE_SIDE

__all__ = ["GenerativeConfig"]


@dataclass(frozen=True)
class GenerativeConfig:
    """How a generative repair is done; lengths are for 512x512 renders and scale with the side.

    Attributes:
        max_side: P. Longer side in pixels of the crop that is inpainted; a larger crop is worked on at that size.
        context: O. Known pixels around the component that the crop shows.
        blend: O. Pixels from the boundary over which the background's depth passes into the aligned one.
        tolerance: O. An alignment sample is an inlier if it is reproduced to this share.
        min_inlier_share: O. Fewest inliers among the samples.
        max_anchors: O. Most anchors of one generative repair; the paper limits local ones only, and a hole of
            9,000 pixels filled by 5,000 anchors would blur what was generated.
    """

    max_side: int = 512
    context: int = 96
    blend: int = 8
    tolerance: float = 0.05
    min_inlier_share: float = 0.5
    max_anchors: int = 20_000

    def __post_init__(self) -> None:
        if self.max_side < 16 or self.context < 1 or self.blend < 0 or self.max_anchors < 1:
            raise BadInput(
                f"generative repair with max_side {self.max_side}, context {self.context}, blend {self.blend} and "
                f"max_anchors {self.max_anchors}",
                "max_side >= 16, context >= 1, blend >= 0, max_anchors >= 1",
                "correct the configuration",
            )

    def scaled(self, width: int, height: int) -> GenerativeConfig:
        """The same for renders of another size: lengths follow the side of a square of that area."""
        side = (width * height) ** 0.5 / REFERENCE_SIDE
        return replace(self, context=max(1, round(self.context * side)), blend=round(self.blend * side))
