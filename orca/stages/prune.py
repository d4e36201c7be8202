"""Anchors that no view uses are left out: nothing that is rendered changes (O)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from orca.camera import Camera
from orca.render.renderer import Renderer

__all__ = ["reached"]


def reached(renderer: Renderer, views: Sequence[Camera]) -> NDArray[np.bool_]:
    """Whether each anchor's footprint lies within at least one view, [N].

    The box around an exact footprint decides: what it leaves out, no ray of these views can hit.
    """
    used = np.zeros(len(renderer.means), bool)
    for view in views:
        if used.all():
            break
        (open_,) = np.nonzero(~used)
        box = renderer.part(~used).boxes(view)
        used[open_] = (box[:, 2] > box[:, 0]) & (box[:, 3] > box[:, 1])
    return used
