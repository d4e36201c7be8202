"""Splats where a fit still errs: the worst are split in two, as few as the error that is to go asks for."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from orca.conventions import Float32Array, Float64Array
from orca.errors import BadInput
from orca.splats.gradient import Footprints, loss_and_gradient
from orca.splats.model import Splats

__all__ = ["blame", "split", "stages", "worst"]

_TAKEN = 0.7  # of its blame that a split splat loses in the next fit (measured: .68 to .80)
_MOST = 1 / 3  # of all splats that are split at once
_OFFSET, _NARROWER = 0.5, 0.6  # of the deviation along the longest axis: where the halves are, and their own
_REACH = 3.0  # deviations of its anchor within which a splat's descendants stay


def blame(seen: Footprints, picture: Float32Array, target: Float32Array, splats: Splats) -> Float64Array:
    """Each splat's share of a view's squared error: what it contributes to a pixel times the pixel's error, [N].

    Args:
        seen: footprints of the splats in the view.
        picture, target: rgb over black as drawn and as it should be, [P, 3] or more columns.
        splats: the N splats.
    """
    error = (picture[:, :3] - target[:, :3]) ** 2
    # The gradient by colour is the sum of contribution times residual, and this picture's residual is the error.
    wanted = np.column_stack([picture[:, :3] - error, target[:, 3:4]]).astype(np.float32)
    sizes = np.zeros(len(splats), np.float32)
    gradient = loss_and_gradient(seen, wanted, splats.colours, splats.opacities, sizes)[1]
    return np.asarray(np.maximum(gradient[:, :3].sum(axis=1, dtype=np.float64), 0))


def worst(blamed: Float64Array, surplus_db: float) -> NDArray[np.int64]:
    """The fewest splats whose splitting should lower the error by so many dB, worst first; a third at most.

    Args:
        blamed: squared error by splat, [N].
        surplus_db: by how much the PSNR is under what it should be.
    """
    order = np.argsort(-blamed, kind="stable")
    goes = np.cumsum(blamed[order]) * _TAKEN
    needed = blamed.sum() * (1 - 10 ** (-surplus_db / 10))
    count = min(int(np.searchsorted(goes, needed)) + 1, int(_MOST * len(blamed)))
    return np.asarray(order[:count], np.int64)


def split(splats: Splats, chosen: NDArray[np.int64]) -> Splats:
    """Each chosen splat becomes two along its longest axis: one in its place, one at the end, in the order given."""
    longest = splats.log_scales[chosen].argmax(axis=1)
    row = np.arange(len(chosen))
    offset = np.float32(_OFFSET) * splats.axes()[chosen][row, :, longest]
    scales = splats.log_scales[chosen]
    scales[row, longest] += np.float32(np.log(_NARROWER))
    halves = [
        replace(_rows(splats, chosen), means=splats.means[chosen] + side * offset, log_scales=scales)
        for side in (np.float32(1), np.float32(-1))
    ]
    kept = {f.name: getattr(splats, f.name).copy() for f in fields(Splats)}
    for name, values in kept.items():
        values[chosen] = getattr(halves[0], name)
        kept[name] = np.concatenate([values, getattr(halves[1], name)])
    return Splats(**kept)


def stages(splats: Splats, anchors: Splats) -> Splats:
    """Splats with the stages of the anchors that they came from, which a file does not hold.

    A splat keeps its anchor's row however often it was split; what was split off has the stage of the row next to it.

    Args:
        splats: as `orca.export.read_splats` read them.
        anchors: the scene's anchors (`orca.splats.bake.anchor_splats`), [N].

    Raises:
        BadInput: fewer splats than anchors or more than two of each, or rows that are not where their anchors are.
    """
    from scipy.spatial import cKDTree

    count = len(anchors)
    if not count <= len(splats) <= 2 * count or _strayed(splats, anchors):
        raise BadInput(
            f"a .ply of {len(splats)} splats that does not follow the scene's {count} anchors",
            "a .ply that was exported from this scene",
            "export it again",
        )
    nearest = cKDTree(splats.means[:count]).query(splats.means[count:])[1]
    return replace(splats, stage=np.concatenate([anchors.stage, anchors.stage[nearest]]))


def _strayed(splats: Splats, anchors: Splats) -> bool:
    distance = np.linalg.norm(splats.means[: len(anchors)] - anchors.means, axis=1)
    far = distance > _REACH * np.exp(anchors.log_scales.max(axis=1)) + 1e-6
    turned = np.abs(splats.quaternions[: len(anchors)] - anchors.quaternions).max(axis=1) > 1e-6
    return bool((far | turned).any())


def _rows(splats: Splats, chosen: NDArray[np.int64]) -> Splats:
    return Splats(**{f.name: getattr(splats, f.name)[chosen] for f in fields(Splats)})
