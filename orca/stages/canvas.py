"""The canvas of stage 1: the original image inside its outpainted extension, both seen by one camera."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from orca.camera import Camera
from orca.config import CanvasConfig
from orca.conventions import Float32Array, Float64Array
from orca.errors import BadInput, OrcaError, Unavailable
from orca.priors.depth import DepthProvider
from orca.priors.outpaint import MirrorOutpainter, Outpainter, extend_depth
from orca.stages.margin_depth import estimated_margin

__all__ = ["Canvas", "make_canvas", "needed_margins"]

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Canvas:
    """The outpainted image and where the original lies in it.

    Attributes:
        image: [H + top + bottom, W + left + right, 3] float32; inside the original's box it is the original, bit
            for bit, since the input view must be reproduced and not the outpainter's copy of it (METHOD.md 2).
        depth: z-depth over the canvas, same size, float32.
        camera: the canvas camera: same centre and orientation, intrinsics shifted by the margins (paper Sec. 3.1).
        margins: left, top, right, bottom in pixels.
        margin_depth: where the depth outside the original comes from, in words.
        note: what a reader of the result must know: that the outpainter failed, and how; else empty.
    """

    image: Float32Array
    depth: Float32Array
    camera: Camera
    margins: tuple[int, int, int, int]
    margin_depth: str = "there is no margin"
    note: str = ""

    @property
    def scale(self) -> tuple[float, float]:
        """How many times wider and higher than the original the canvas is."""
        height, width = self.image.shape[:2]
        left, top, right, bottom = self.margins
        return width / (width - left - right), height / (height - top - bottom)

    @property
    def original(self) -> tuple[slice, slice]:
        """Rows and columns of the original image."""
        left, top, right, bottom = self.margins
        height, width = self.image.shape[:2]
        return slice(top, height - bottom), slice(left, width - right)


def needed_margins(
    camera: Camera, trajectory: Sequence[Camera], depth: Float32Array, max_scale: float
) -> tuple[int, int, int, int]:
    """How far a trajectory looks outside the input image: margins in pixels (left, top, right, bottom).

    The borders of every view are put at the scene's far depth (98th percentile) and projected into the input camera.
    """
    limit = (max_scale - 1) / 2
    far = float(np.quantile(depth, 0.98))
    low, high = np.zeros(2), np.array([camera.width, camera.height], np.float64)
    for view in trajectory:
        pixels, z = camera.project(view.unproject(_border(view), np.full(4 * 33, far)))
        pixels = pixels[z > 0.1 * far]
        if len(pixels):
            low, high = np.minimum(low, pixels.min(0)), np.maximum(high, pixels.max(0))
    size = np.array([camera.width, camera.height])
    before = np.ceil(np.clip(-low, 0, limit * size)).astype(int)
    after = np.ceil(np.clip(high - size, 0, limit * size)).astype(int)
    return int(before[0]), int(before[1]), int(after[0]), int(after[1])


def _border(view: Camera) -> Float64Array:
    """132 points along the border of a view, (x, y)."""
    s = np.linspace(0, 1, 33)
    zero, one = np.zeros(33), np.ones(33)
    edges = [np.stack(e, 1) for e in ((s, zero), (s, one), (zero, s), (one, s))]
    return np.asarray(np.concatenate(edges) * [view.width, view.height])


def make_canvas(
    image: Float32Array,
    depth: Float32Array,
    camera: Camera,
    trajectory: Sequence[Camera],
    config: CanvasConfig,
    outpainter: Outpainter | None,
    estimator: DepthProvider | None = None,
) -> Canvas:
    """Outpaint as far as the trajectory looks; without an outpainter the canvas is the image itself.

    An outpainter that invents content needs depth that belongs to it: with an ``estimator`` it is estimated on the
    outpainted image. What mirrors or repeats the image takes depth the same way, and their mean takes it mirrored.
    Where an outpainter fails, or what it returns is no image of the size asked for, the image is mirrored instead and
    the canvas carries a note.
    """
    if outpainter is None:
        return Canvas(image, depth, camera, (0, 0, 0, 0))
    margins = needed_margins(camera, trajectory, depth, config.max_scale)
    painted, failure = _outpainted(outpainter, image, margins)
    if failure:
        outpainter = MirrorOutpainter()
    invents = outpainter.name not in ("mean", "mirror", "edge")
    mode: Literal["mirror", "edge"] = "mirror" if outpainter.name in ("mean", "mirror") else "edge"
    extended, words = extend_depth(depth, *margins, mode=mode), f"the original's, extended ({mode})"
    wide = camera.padded(*margins)
    original = (slice(margins[1], margins[1] + image.shape[0]), slice(margins[0], margins[0] + image.shape[1]))
    if invents and estimator is not None and any(margins):
        extended, words = estimated_margin(painted, extended, original, wide, estimator)
    painted[original] = image
    return Canvas(painted, extended, wide, margins, words, failure)


def _outpainted(
    outpainter: Outpainter, image: Float32Array, margins: tuple[int, int, int, int]
) -> tuple[Float32Array, str]:
    """The extended image, [H', W', 3] in [0, 1], and why it is a mirrored one; empty where it is the outpainter's."""
    left, top, right, bottom = margins
    wanted = (image.shape[0] + top + bottom, image.shape[1] + left + right, 3)
    try:
        painted = np.array(outpainter.outpaint(image, *margins), np.float32)
        if painted.shape == wanted and bool(np.isfinite(painted).all()):
            return np.clip(painted, 0.0, 1.0), ""
        reason = f"it returned shape {painted.shape} for {wanted}, or colours that are not finite"
    except (BadInput, Unavailable):  # the caller's fault, or a package that is not there
        raise
    except Exception as error:  # noqa: BLE001 - somebody else's model: whatever it raises, the image can be mirrored
        said = error.given if isinstance(error, OrcaError) else f"{type(error).__name__}: {error}"
        reason = " ".join(said.split())[:300]
    note = f"outpainter '{outpainter.name}' failed, the image is mirrored beyond the frame instead: {reason}"
    _log.warning("%s", note)
    return MirrorOutpainter().outpaint(image, *margins), note
