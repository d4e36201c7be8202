"""What to show where no anchor is: the colours around it, so that a pinhole does not shine through as black.

A picture's business only. Coverage stays what it was, so holes are counted and repaired as before; nothing is added to
the scene. The colours come from an image pyramid, averaged upwards and spread downwards (push-pull; Gortler et al.
1996, The Lumigraph).
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from orca.config import RenderConfig
from orca.conventions import Float32Array
from orca.render.renderer import Rendering

__all__ = ["as_shown", "push_pull"]

_OPEN = 1e-3  # a pixel stays as it was fitted where no more than this share of it is open (best of 0 to 0.3)
_LEAST = 1e-6  # coverage of a whole view under which there is nothing to spread


def as_shown(view: Rendering, config: RenderConfig) -> Rendering:
    """A view as it is shown: behind what it leaves open lies what is around, or the plain background.

    Args:
        view: a render over ``config.background``.
        config: how it was rendered; ``backdrop`` chooses.
    """
    open_ = 1 - view.alpha
    if config.backdrop == "plain" or open_.max(initial=0.0) <= _OPEN or view.alpha.mean() < _LEAST:
        return view
    scene = view.rgb - open_[..., None] * np.float32(config.background)
    return replace(view, rgb=np.where(open_[..., None] > _OPEN, push_pull(scene, view.alpha), view.rgb))


def push_pull(colour: Float32Array, weight: Float32Array) -> Float32Array:
    """The colours, and behind what they leave open those spread from around, [H, W, 3].

    Args:
        colour: colours times their weights, [H, W, 3].
        weight: how well each pixel is known, [H, W], 0 to 1; somewhere more than 0.
    """
    levels = [(colour, weight)]
    while max(levels[-1][1].shape) > 1:
        colour, weight = (cv2.pyrDown(image, borderType=cv2.BORDER_REPLICATE) for image in levels[-1])
        levels.append((np.asarray(colour, np.float32), np.asarray(weight, np.float32)))
    colour, weight = levels.pop()
    spread = np.asarray(colour / np.maximum(weight, _LEAST)[..., None], np.float32).reshape(*weight.shape, 3)
    for colour, weight in reversed(levels):
        height, width = weight.shape
        coarse = cv2.resize(spread, (width, height), interpolation=cv2.INTER_LINEAR)
        spread = np.asarray(colour + (1 - weight)[..., None] * coarse, np.float32)
    return spread
