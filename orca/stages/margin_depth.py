"""Depth of what was outpainted: estimated on the whole canvas and fitted to the original's, else extended from it."""

from __future__ import annotations

import numpy as np

from orca.camera import Camera
from orca.conventions import Float32Array
from orca.errors import BadInput, OrcaError
from orca.priors.depth import DepthProvider
from orca.repair.align import blend_boundary, robust_affine

__all__ = ["estimated_margin"]

_BLEND = 1 / 16  # of the canvas's shorter side: over this many pixels the extension passes into the estimate


def estimated_margin(
    image: Float32Array,
    extended: Float32Array,
    original: tuple[slice, slice],
    camera: Camera,
    provider: DepthProvider,
) -> tuple[Float32Array, str]:
    """Depth of an outpainted canvas as the paper has it: the provider looks at the outpainted image (Sec. 3.2).

    The estimate is fitted to the original's depth inside the frame (affine in depth, or in inverse depth where the
    provider's depth is relative), and takes over from the extended depth outside it.

    Args:
        image: the canvas, [H, W, 3].
        extended: the original's depth, extended over the canvas, [H, W]; kept bit for bit inside the frame.
        original: rows and columns of the original.
        camera: the canvas camera.
        provider: estimates depth.

    Returns:
        Depth [H, W], positive, and how it came about in words. Where the provider fails, that is ``extended``.
    """
    inside = np.zeros(extended.shape, bool)
    inside[original] = True
    try:
        estimate = provider.estimate(image, camera)
        if estimate.depth.shape != extended.shape:
            raise _wrong_size(estimate.depth.shape, extended.shape)
        predicted, target = estimate.depth, extended
        if not estimate.is_metric:
            predicted, target = 1.0 / predicted, 1.0 / extended
        fit = robust_affine(predicted[inside], target[inside], tolerance=0.1)
    except Exception as error:  # noqa: BLE001 - somebody else's model: whatever it raises, the depth can be extended
        said = error.given if isinstance(error, OrcaError) else f"{type(error).__name__}: {error}"
        return extended, f"extended from the frame, because {provider.name} failed: {' '.join(said.split())[:300]}"
    aligned = fit.apply(predicted)
    # A line may leave the range of what it was fitted on; the original's range, doubled, is the limit.
    low, high = float(target[inside].min()) / 2, 2 * float(target[inside].max())
    aligned = np.clip(aligned, np.float32(low), np.float32(high))
    if not estimate.is_metric:
        aligned = 1.0 / aligned
    depth = blend_boundary(aligned.astype(np.float32), extended, ~inside, _BLEND * min(extended.shape))
    return depth, f"{provider.name} on the outpainted image, {fit.inlier_share:.0%} of the frame within 10 %"


def _wrong_size(given: tuple[int, ...], wanted: tuple[int, ...]) -> BadInput:
    return BadInput(
        f"depth of shape {given} for a canvas of {wanted}", "depth of the canvas's size", "mend the provider"
    )
