"""The RGB-D target of a generative repair: an inpainted crop, its depth estimated and fitted to the scene (paper 3.3).

Nothing that fails here ends a reconstruction: `generative_fill` raises `GenerativeFailed`, the loop repairs locally.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from orca.camera import Camera
from orca.conventions import Float32Array
from orca.errors import OrcaError
from orca.priors.depth import DepthProvider
from orca.priors.inpaint import Inpainter
from orca.repair.align import AffineFit, AlignmentFailed, blend_boundary, robust_affine
from orca.repair.background import background_pixels
from orca.repair.components import BoolArray, Component
from orca.repair.donors import FillTarget
from orca.repair.generative_config import GenerativeConfig
from orca.repair.views import Box, crop_camera

__all__ = ["Alignment", "GenerativeFailed", "GenerativeFill", "GenerativePriors", "generative_fill"]

_BLACK = 2 / 255
_DARK = 8 / 255


class GenerativeFailed(OrcaError):
    """Inpainting, its depth, or the alignment of that depth failed; the caller repairs locally and records why."""

    kind = "generative_failed"


@dataclass(frozen=True)
class GenerativePriors:
    """Who completes a region.

    Attributes:
        inpainter: colours.
        depth: depth of the completed crop; None continues the background's depth into the hole instead.
    """

    inpainter: Inpainter
    depth: DepthProvider | None = None


@dataclass(frozen=True)
class Alignment:
    """How the predicted depth was fitted to the scene's.

    Attributes:
        fit: the affine map and its inlier share.
        space: "depth" (the paper's d = a d_pred + b) or "inverse_depth" (O: for providers whose depth is relative,
            whose inverse depth is what is affine to the true one).
        samples: background pixels it was fitted on.
    """

    fit: AffineFit
    space: str
    samples: int

    def to_json(self) -> dict[str, Any]:
        """For the ledger."""
        fit = self.fit
        return {
            "a": fit.a,
            "b": fit.b,
            "inlier_share": fit.inlier_share,
            "samples": self.samples,
            "space": self.space,
        }


@dataclass(frozen=True, eq=False)
class GenerativeFill:
    """A completed region: the target of the new anchors, and how its depth was aligned (None: continued)."""

    target: FillTarget
    alignment: Alignment | None


@dataclass(frozen=True, eq=False)
class _Crop:
    """What the priors see. All [h, w] or [h, w, 3]; ``hole`` is the component, ``known`` what the scene shows."""

    box: Box
    rgb: Float32Array
    depth: Float32Array
    known: BoolArray
    hole: BoolArray


def generative_fill(
    rgb: Float32Array,
    depth: Float32Array,
    valid: BoolArray,
    component: Component,
    local: FillTarget,
    camera: Camera,
    priors: GenerativePriors,
    config: GenerativeConfig,
) -> GenerativeFill:
    """Complete a component from a crop around it. Only the component's pixels are ever taken from the priors.

    Args:
        rgb: rendered colours, [H, W, 3].
        depth: rendered z-depth, [H, W].
        valid: pixels that show the reconstruction, [H, W].
        component: the region to complete.
        local: the local fill of the same component; its depth is the background's, continued into the hole.
        camera: the view.
        priors: inpainter and depth provider.
        config: for this render size (`GenerativeConfig.scaled`).

    Raises:
        GenerativeFailed: whatever went wrong, with the reason in one sentence.
    """
    crop = _crop(rgb, depth, valid, component, config)
    completed = _completed(crop, priors.inpainter, config.max_side)
    continued = crop.depth.copy()
    x0, y0 = crop.box[:2]
    continued[local.y - y0, local.x - x0] = local.depth
    alignment, target_depth = None, continued
    name = f"generative:{priors.inpainter.name}+continued"
    if priors.depth is not None:
        aligned, alignment = _aligned_depth(completed, crop, crop_camera(camera, crop.box), priors.depth, config)
        target_depth = blend_boundary(aligned, continued, crop.hole, config.blend)
        name = f"generative:{priors.inpainter.name}+{priors.depth.name}"
    y, x = np.nonzero(crop.hole)
    found = target_depth[y, x]
    if not bool((np.isfinite(found) & (found > 0)).all()):
        raise _failed("the completed depth has values that are no depth")
    target = FillTarget(
        y=y + y0,
        x=x + x0,
        rgb=completed[y, x],
        depth=found,
        donors=0 if alignment is None else alignment.samples,
        scheme=name,
        depth_threshold=local.depth_threshold,
    )
    return GenerativeFill(target, alignment)


def _failed(why: str, cause: str = "") -> GenerativeFailed:
    return GenerativeFailed(f"{why}{cause}", "a completed crop whose depth fits the scene", "repair it locally")


def _crop(
    rgb: Float32Array, depth: Float32Array, valid: BoolArray, component: Component, config: GenerativeConfig
) -> _Crop:
    """The component with ``context`` pixels on each side, as far as the image goes."""
    height, width = valid.shape
    x0, y0, x1, y1 = component.bbox
    margin = config.context
    box = (max(0, x0 - margin), max(0, y0 - margin), min(width, x1 + margin), min(height, y1 + margin))
    part = slice(box[1], box[3]), slice(box[0], box[2])
    hole = component.full_mask(height, width)[part]
    known = valid[part] & ~hole
    if not known.any():
        raise _failed("the crop shows nothing of the scene: there is nothing to go by")
    return _Crop(box, rgb[part], depth[part], known, hole)


def _completed(crop: _Crop, inpainter: Inpainter, max_side: int) -> Float32Array:
    """The crop's colours with the hole filled, checked; worked on at ``max_side`` at most."""
    height, width = crop.hole.shape
    scale = min(1.0, max_side / max(height, width))
    unknown, given = ~crop.known, np.where(crop.known[..., None], np.clip(crop.rgb, 0.0, 1.0), np.float32(0))
    given = given.astype(np.float32)
    if scale < 1.0:
        size = (max(1, round(width * scale)), max(1, round(height * scale)))
        unknown = cv2.resize(unknown.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 1e-3
        given = np.asarray(cv2.resize(given, size, interpolation=cv2.INTER_AREA), np.float32)
        if unknown.all():
            raise _failed("at the inpainter's resolution nothing of the scene is left in the crop")
    try:
        filled = np.asarray(inpainter.inpaint(given, unknown), np.float32)
    except Exception as error:
        raise _failed(f"inpainter '{inpainter.name}' failed: ", _words(error)) from error
    if filled.shape != given.shape:
        raise _failed(f"inpainter '{inpainter.name}' returned shape {filled.shape} for {given.shape}")
    if scale < 1.0:
        filled = np.asarray(cv2.resize(filled, (width, height), interpolation=cv2.INTER_CUBIC), np.float32)
    colours = filled[crop.hole]
    if not bool(np.isfinite(colours).all()):
        raise _failed(f"inpainter '{inpainter.name}' returned colours that are not finite")
    if float(colours.max()) <= _BLACK and float(np.median(crop.rgb[crop.known].max(-1))) > _DARK:
        raise _failed(f"inpainter '{inpainter.name}' returned nothing but black")
    completed = np.where(crop.hole[..., None], np.clip(filled, 0.0, 1.0), crop.rgb).astype(np.float32)
    # Other holes are no part of this repair, but the depth provider must not see them black.
    elsewhere = ~crop.hole & ~crop.known
    completed[elsewhere] = np.clip(np.nan_to_num(filled[elsewhere]), 0.0, 1.0)
    return completed


def _aligned_depth(
    completed: Float32Array, crop: _Crop, camera: Camera, provider: DepthProvider, config: GenerativeConfig
) -> tuple[Float32Array, Alignment]:
    """The provider's depth of the completed crop, fitted to the scene's on the background around the hole."""
    try:
        estimate = provider.estimate(completed, camera)
    except Exception as error:
        raise _failed(f"depth provider '{provider.name}' failed: ", _words(error)) from error
    if estimate.depth.shape != crop.hole.shape:
        raise _failed(f"depth provider '{provider.name}' returned shape {estimate.depth.shape} for {crop.hole.shape}")
    background = background_pixels(crop.depth, crop.known & (crop.depth > 0), crop.hole, config.context)
    space = "depth" if estimate.is_metric else "inverse_depth"
    predicted, scene = estimate.depth, crop.depth
    if space == "inverse_depth":
        predicted = (1.0 / predicted).astype(np.float32)
        scene = np.divide(1.0, scene, out=np.zeros_like(scene), where=scene > 0)
    try:
        fit = robust_affine(
            predicted[background],
            scene[background],
            tolerance=config.tolerance,
            min_inlier_share=config.min_inlier_share,
        )
    except AlignmentFailed as error:
        raise _failed(error.given) from error
    aligned = fit.apply(predicted)
    if space == "inverse_depth":
        # A line may cross zero where the prediction is farther than any sample: the farthest sample is the limit.
        aligned = np.reciprocal(np.maximum(aligned, np.float32(scene[background].min() / 2)))
    return aligned, Alignment(fit, space, int(np.count_nonzero(background)))


def _words(error: Exception) -> str:
    """What an error says, on one line."""
    said = error.given if isinstance(error, OrcaError) else f"{type(error).__name__}: {error}"
    return " ".join(said.split())[:300]
