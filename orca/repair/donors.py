"""The RGB-D target of a local repair: a hole filled from the background around it (paper, "Disocclusion Repair")."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from orca.conventions import Float32Array, Float64Array
from orca.errors import BadInput, Unknown
from orca.repair.background import background_pixels
from orca.repair.components import BoolArray, Component, IntArray
from orca.repair.holdout import foretold_share
from orca.repair.membrane import linear_trend, membrane, mirrored_detail
from orca.repair.rules import RepairRules
from orca.repair.structure import ExemplarRules, continue_structure
from orca.threads import map_on_cores

__all__ = ["FILL_SCHEMES", "FillTarget", "local_fill"]

FILL_SCHEMES = ("paper", "smooth", "structure")

_NEIGHBOURS = 4
_DETAIL_SIGMA = 6.0
_DEPTH_MARGIN = 1.01
_EXTRAPOLATION = 0.7


@dataclass(frozen=True, eq=False)
class FillTarget:
    """What a local repair should show inside its component.

    Attributes:
        y: row of each hole pixel, [n].
        x: column of each hole pixel, [n].
        rgb: target colour, [n, 3] float32 in [0, 1].
        depth: target z-depth, [n] float32, positive.
        donors: donor pixels used.
        scheme: "paper:percentile" (the paper's donors), "smooth:background" or "structure:background"
            (foreground found and left out), "...:all" (no foreground around the hole), "...:nearest" (too few donors).
        depth_threshold: donors are at this depth or beyond.
        foretold: "structure" only: share of the texture that was continued, on average over the hole; the rest is
            membrane (`foretold_share`).
    """

    y: IntArray
    x: IntArray
    rgb: Float32Array
    depth: Float32Array
    donors: int
    scheme: str
    depth_threshold: float
    foretold: float | None = None

    @property
    def is_nearest(self) -> bool:
        """Whether the fill fell back to nearest neighbours."""
        return self.scheme.endswith(":nearest")


@dataclass(frozen=True, eq=False)
class _Crop:
    """The neighbourhood of a component.

    Image, usable pixels, the hole, each pixel's distance to it, and the least possible depth inside it.
    """

    rgb: Float32Array
    depth: Float32Array
    valid: BoolArray
    hole: BoolArray
    distance: Float32Array
    least: Float32Array | None = None

    def ring(self, inner: float, outer: float) -> BoolArray:
        """Valid pixels at ``inner`` to ``outer`` pixels from the hole."""
        return np.asarray(self.valid & (self.distance >= inner) & (self.distance <= outer))


def local_fill(
    rgb: Float32Array,
    depth: Float32Array,
    valid: BoolArray,
    component: Component,
    rules: RepairRules,
    scheme: Literal["paper", "smooth", "structure"] = "structure",
    least: Float32Array | None = None,
) -> FillTarget:
    """Colours and depths for a component from the background in a ring around it.

    ``"paper"``: donors are the ring's pixels (``ring_inner`` to ``ring_outer``) at or beyond the
    ``donor_percentile``-th percentile of its depth; a hole pixel takes the inverse-distance mean of its 4 nearest.
    ``"smooth"`` (ours): donors are all background pixels from ``smooth_ring_inner`` on (`background_pixels`); colour
    and inverse depth are continued by a membrane, and ``detail_gain`` of the donors' texture is mirrored into the
    hole. Depth is clamped behind the foreground. ``"structure"`` (ours): the same, but depth comes from patches of
    the background within ``context`` pixels (`continue_structure`) wherever there are enough to choose from, and
    colour to the extent that such patches foretell what is known beside the hole (`foretold_share`). With fewer than
    ``min_donors`` donors, all take the nearest valid pixel.

    Args:
        rgb: rendered colours, [H, W, 3].
        depth: rendered z-depth, [H, W]: the surface's, i.e. already divided by the accumulated alpha.
        valid: pixels that show the reconstruction, [H, W]; pixels without a usable depth or colour are left out.
        component: the region to fill.
        rules: constants for this render size (`RepairRules.scaled`).
        scheme: "paper", "smooth" or "structure".
        least: smallest possible z-depth at each pixel of the component (`InputSurface.least_depth`), [H, W]; where it
            is given, it tells foreground from background, and no filled pixel is nearer. The paper's scheme ignores it.

    Raises:
        BadInput: shapes that do not match, or no valid pixel in the whole image.
        Unknown: another scheme.
    """
    usable = _checked(rgb, depth, valid, component, scheme)
    margin = rules.context if scheme == "structure" else rules.ring_outer
    crop = _crop(rgb, depth, usable, component, margin, None if scheme == "paper" else least)
    if scheme == "paper":
        target = _paper_fill(crop, component, rules)
    else:
        target = _background_fill(crop, component, rules, scheme)
    return target if target is not None else _nearest_fill(rgb, depth, usable, component, scheme)


def _checked(rgb: Float32Array, depth: Float32Array, valid: BoolArray, component: Component, scheme: str) -> BoolArray:
    """The usable pixels, after the checks of `local_fill`."""
    if scheme not in FILL_SCHEMES:
        raise Unknown(f"unknown fill scheme '{scheme}'", ", ".join(FILL_SCHEMES), "choose one of them")
    height, width = depth.shape[:2] if depth.ndim == 2 else (-1, -1)
    if rgb.shape != (height, width, 3) or valid.shape != (height, width) or valid.dtype != np.bool_:
        raise BadInput(
            f"colours {rgb.shape}, depth {depth.shape}, valid {valid.shape} of type {valid.dtype}",
            "[H, W, 3], [H, W] and bool [H, W] of one render",
            "pass the buffers of one view",
        )
    if component.bbox[2] > width or component.bbox[3] > height:
        raise BadInput(
            f"component at {component.bbox} in an image of {width}x{height}", "one inside it", "use this view's mask"
        )
    usable = valid & np.isfinite(depth) & (depth > 0) & np.isfinite(rgb).all(axis=2)
    usable &= ~component.full_mask(height, width)
    if not usable.any():
        raise BadInput(
            "a view without a single valid pixel",
            "at least one pixel of the scene",
            "leave this view out of the repair",
        )
    return np.asarray(usable)


def _crop(
    rgb: Float32Array,
    depth: Float32Array,
    usable: BoolArray,
    component: Component,
    outer: int,
    least: Float32Array | None,
) -> _Crop:
    """Cut out the component and its ring: the cost then follows the component and not the image."""
    height, width = depth.shape
    x0, y0, x1, y1 = component.bbox
    margin = outer + 1
    left, top = max(0, x0 - margin), max(0, y0 - margin)
    window = np.s_[top : min(height, y1 + margin), left : min(width, x1 + margin)]
    hole = np.zeros(depth[window].shape, bool)
    hole[y0 - top : y1 - top, x0 - left : x1 - left] = component.mask
    distance = cv2.distanceTransform((~hole).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5)
    bound = None if least is None else np.where(hole, least[window], np.float32(0.0))
    return _Crop(rgb[window], depth[window], usable[window], hole, distance, bound)


def _target(
    component: Component, rgb: NDArray[np.floating[Any]], depth: NDArray[np.floating[Any]], **about: Any
) -> FillTarget:
    y, x = component.pixels()
    colours = np.clip(rgb, 0.0, 1.0).astype(np.float32)
    return FillTarget(y=y, x=x, rgb=colours, depth=depth.astype(np.float32), **about)


def _paper_fill(crop: _Crop, component: Component, rules: RepairRules) -> FillTarget | None:
    """The paper's donors; None if they are fewer than ``min_donors``."""
    ring = crop.ring(rules.ring_inner, rules.ring_outer)
    if not ring.any():
        return None
    threshold = float(np.percentile(crop.depth[ring], rules.donor_percentile))
    donors = ring & (crop.depth >= threshold)
    count = int(np.count_nonzero(donors))
    if count < rules.min_donors:
        return None
    index, weight = _nearest_weights(donors, crop.hole)
    rgb = np.einsum("nk,nkc->nc", weight, crop.rgb[donors][index])
    depth = np.einsum("nk,nk->n", weight, crop.depth[donors][index])
    return _target(component, rgb, depth, donors=count, scheme="paper:percentile", depth_threshold=threshold)


def _nearest_weights(donors: BoolArray, hole: BoolArray) -> tuple[IntArray, Float64Array]:
    """For each hole pixel its nearest donors (index among donors, [n, k]) and inverse-square-distance weights."""
    points = np.argwhere(donors)
    k = min(_NEIGHBOURS, len(points))
    distance, index = cKDTree(points).query(np.argwhere(hole), k=np.arange(1, k + 1))
    weight = 1.0 / distance**2
    return index, weight / weight.sum(axis=1, keepdims=True)


def _background_fill(crop: _Crop, component: Component, rules: RepairRules, scheme: str) -> FillTarget | None:
    """The background of a wide ring, continued; None if it is less than ``min_donors`` pixels."""
    wide = crop.ring(rules.smooth_ring_inner, rules.context if scheme == "structure" else rules.ring_outer)
    source = background_pixels(crop.depth, wide, crop.hole, rules.ring_outer, crop.least)
    near = crop.distance <= rules.ring_outer
    donors = source & near
    count = int(np.count_nonzero(donors))
    if count < rules.min_donors:
        return None
    foreground = wide & near & ~donors
    if scheme == "structure":
        rgb, inverse, foretold = _structure_fill(crop, donors, source, rules)
    else:
        rgb, inverse, foretold = _smooth_colours(crop, donors, rules), _membrane_inverse_depth(crop, donors), None
    scheme = "smooth" if foretold is None else "structure"
    return _target(
        component,
        rgb[crop.hole],
        1.0 / _behind_foreground(inverse, crop, donors, foreground)[crop.hole],
        donors=count,
        scheme=f"{scheme}:{'background' if foreground.any() else 'all'}",
        depth_threshold=float(crop.depth[donors].min()),
        foretold=foretold,
    )


def _structure_fill(
    crop: _Crop, donors: BoolArray, source: BoolArray, rules: RepairRules
) -> tuple[Float32Array, Float32Array, float | None]:
    """Colour and inverse depth from patches of the background, and their `foretold_share`; None: from the membrane.

    The pixels that touch the hole are blended with the foreground that hid it: they are neither copied nor believed,
    but filled along with the hole. What does not need each other is made at once, each on a core, the longest first.
    """
    blended = source & (crop.distance < rules.ring_inner)
    trusted = source & ~blended
    inverse = np.where(trusted, 1.0 / np.where(trusted, crop.depth, 1.0), 0.0).astype(np.float32)
    patch = ExemplarRules(rules.patch_radius, rules.patch_matches)
    parts: tuple[Callable[[], Any], ...] = (
        lambda: continue_structure(crop.rgb, inverse, trusted, crop.hole | blended, patch),
        lambda: foretold_share(crop.rgb, inverse, trusted, crop.hole, patch, rules.ring_inner, rules.ring_outer),
        lambda: _membrane_inverse_depth(crop, donors),
        lambda: membrane(crop.rgb, donors),
    )
    made, foretold, smooth_inverse, base = map_on_cores(lambda part: part(), parts)
    if made is None:
        return _smooth_colours(crop, donors, rules), smooth_inverse, None
    continued, continued_inverse, known = made
    rgb = np.where(known[..., None], base + foretold[..., None] * (continued - base), base)
    return rgb, np.where(known, continued_inverse, smooth_inverse), float(foretold[crop.hole].mean())


def _smooth_colours(crop: _Crop, donors: BoolArray, rules: RepairRules) -> Float32Array:
    """A membrane over the donors, with a share of their texture mirrored into the hole, [h, w, 3]."""
    rgb = membrane(crop.rgb, donors)
    if rules.detail_gain > 0:
        band = max(1.0, 0.8 * (rules.ring_outer - rules.smooth_ring_inner))
        rgb = rgb + np.float32(rules.detail_gain) * mirrored_detail(crop.rgb, donors, band, _DETAIL_SIGMA)
    return rgb


def _membrane_inverse_depth(crop: _Crop, donors: BoolArray) -> Float32Array:
    """Inverse depth continued from the donors, [h, w].

    A plane in space is linear in inverse depth, so where the donors lie on one, it is continued as such and the
    membrane carries only what deviates from it.
    """
    inverse = np.zeros(crop.depth.shape, np.float32)
    inverse[donors] = 1.0 / crop.depth[donors]
    trend = linear_trend(inverse, donors)
    return np.asarray(trend + membrane((inverse - trend)[..., None], donors)[..., 0], np.float32)


def _behind_foreground(filled: Float32Array, crop: _Crop, donors: BoolArray, foreground: BoolArray) -> Float32Array:
    """Inverse depth within reason: not far beyond the donors, behind the nearest foreground, and where it may be."""
    inverse = np.zeros(crop.depth.shape, np.float32)
    known = donors | foreground
    inverse[known] = 1.0 / crop.depth[known]
    low, high = float(inverse[donors].min()), float(inverse[donors].max())
    filled = np.clip(filled, _EXTRAPOLATION * low, high)
    if foreground.any():
        filled = np.minimum(filled, _nearest_value(inverse, foreground) / np.float32(_DEPTH_MARGIN))
    if crop.least is not None:
        filled = np.minimum(filled, 1.0 / np.maximum(crop.least, 1e-6))
    return np.asarray(filled, np.float32)


def _nearest_value(values: Float32Array, source: BoolArray) -> Float32Array:
    """The value of the nearest ``source`` pixel, [h, w]."""
    _, labels = cv2.distanceTransformWithLabels(
        (~source).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    table = np.zeros(int(labels.max()) + 1, np.float32)
    table[labels[source]] = values[source]
    return np.asarray(table[labels])


def _nearest_fill(
    rgb: Float32Array, depth: Float32Array, usable: BoolArray, component: Component, scheme: str
) -> FillTarget:
    """Nearest-neighbour fill from any valid pixel of the image."""
    y, x = component.pixels()
    points = np.argwhere(usable)
    _, index = cKDTree(points).query(np.stack([y, x], axis=1))
    used = points[np.unique(index)]
    source = points[index]
    return _target(
        component,
        rgb[source[:, 0], source[:, 1]],
        depth[source[:, 0], source[:, 1]],
        donors=len(used),
        scheme=f"{scheme}:nearest",
        depth_threshold=float(depth[used[:, 0], used[:, 1]].min()),
    )
