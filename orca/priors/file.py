"""Depth from a file: PNG or NPY, with a declared unit and meaning."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from orca.array_file import read_npy, read_png
from orca.camera import Camera
from orca.conventions import Float32Array, Float64Array
from orca.errors import BadInput
from orca.priors.depth import DepthEstimate, inverse_to_depth
from orca.priors.spec import PriorSpec

__all__ = ["FileDepth", "read_depth_values"]

MEANINGS = ("depth", "inverse_depth", "disparity")
_ASPECT_TOLERANCE = 0.02


@dataclass(frozen=True)
class FileDepth:
    """``file:PATH?unit=0.0001&meaning=depth``: a depth map that is already there.

    Attributes:
        path: PNG (8 or 16 bits, one channel) or NPY ([H, W], any real type).
        unit: factor on the stored values. Undeclared, they are taken as they are (noted).
        meaning: what value * unit is:
            ``depth``: z-depth;
            ``inverse_depth``: 1 / z, proportional to true inverse depth;
            ``disparity``: pixels of a rectified stereo pair. With ``focal`` (pixels) and ``baseline`` (and ``offset``,
            the difference of the two principal points, added to the disparity) z = focal * baseline / disparity and
            is metric; without them it is relative inverse depth, z = 1 / disparity, at most 10 times the median, and
            not metric.
        focal, baseline, offset: see ``disparity``; pixels of the image, also where the map is resized.
        resize: scale a map of another size to the image; the shape of the frame must agree within 2 %.
        fill: replace NaN, infinite and non-positive values by the nearest good one instead of refusing the file.
            An inverse depth or disparity of exactly 0 then means infinitely far: 10 times the median depth.
        measured: the depth was measured (stereo, a scanner), so that its edges are taken as they are.
        metric: overrides what ``meaning`` says about being proportional to true depth.
        hfov_deg: the horizontal field of view, if the maker of the map knows it (option ``hfov``).
    """

    path: Path
    unit: float | None = None
    meaning: str = "depth"
    focal: float | None = None
    baseline: float | None = None
    offset: float = 0.0
    resize: bool = False
    fill: bool = False
    metric: bool | None = None
    measured: bool = False
    hfov_deg: float | None = None
    name: str = "file"

    @classmethod
    def from_spec(cls, spec: PriorSpec) -> FileDepth:
        """Read the options; see the class for their meaning."""
        spec.allow("unit", "meaning", "focal", "baseline", "offset", "resize", "fill", "metric", "measured", "hfov")
        focal, baseline = spec.optional_number("focal"), spec.optional_number("baseline")
        if (focal is None) != (baseline is None):
            raise BadInput("only one of focal and baseline", "both or neither", "give focal=PIXELS&baseline=LENGTH")
        return cls(
            path=spec.need_path(),
            unit=spec.optional_number("unit"),
            meaning=spec.choice("meaning", MEANINGS, "depth"),
            focal=focal,
            baseline=baseline,
            offset=spec.optional_number("offset") or 0.0,
            resize=spec.flag("resize", False),
            fill=spec.flag("fill", False),
            measured=spec.flag("measured", False),
            metric=spec.flag("metric", True) if "metric" in spec.options else None,
            hfov_deg=spec.optional_number("hfov"),
        )

    def estimate(self, image: Float32Array, camera: Camera) -> DepthEstimate:
        """See `DepthProvider`; the map must have the image's size (or ``resize``)."""
        values = read_depth_values(self.path) * (1.0 if self.unit is None else self.unit)
        values = self._fit(values, image.shape[0], image.shape[1])
        values, notes = self._check(values)
        if self.unit is None:
            notes += ("unit not declared: stored values taken as they are",)
        calibrated = self.meaning != "disparity" or self.focal is not None
        return DepthEstimate(
            depth=self._to_depth(values),
            source=f"file {self.path.name} ({self.meaning.replace('_', ' ')})",
            is_measured=self.measured,
            is_metric=calibrated if self.metric is None else self.metric,
            hfov_deg=self.hfov_deg,
            notes=notes,
        )

    def _fit(self, values: Float64Array, height: int, width: int) -> Float64Array:
        """The map at the image's size. Nearest samples: a mean across a depth edge is a depth that nothing has."""
        h, w = values.shape
        if (h, w) == (height, width):
            return values
        aspect = abs(w * height / (h * width) - 1.0)
        if not self.resize or aspect > _ASPECT_TOLERANCE:
            wanted = "of the same proportions" if self.resize else "of the same size"
            fix = "use the depth map of this image" if self.resize else "add resize=1 to the depth option"
            raise BadInput(f"depth {w}x{h} for an image of {width}x{height}", f"a map {wanted}", fix)
        resized = cv2.resize(values, (width, height), interpolation=cv2.INTER_NEAREST_EXACT)
        if self.meaning == "disparity":
            resized = resized * (width / w)  # pixels of the map become pixels of the image
        return np.asarray(resized, np.float64)

    def _check(self, values: Float64Array) -> tuple[Float64Array, tuple[str, ...]]:
        """Values that can be inverted, and a note about those that were filled in."""
        good = np.isfinite(values) & (values > 0)
        bad = int(good.size - np.count_nonzero(good))
        if bad == 0:
            return values, ()
        if not self.fill or bad == good.size:
            detail = f"{int(np.isnan(values).sum())} NaN, {int(np.isinf(values).sum())} infinite"
            raise BadInput(
                f"depth file '{self.path}': {bad} of {good.size} values are no depth ({detail}, the rest <= 0)",
                "finite values above 0",
                "use another file" if bad == good.size else "repair the file, or add fill=1 to the depth option",
            )
        sky = (values == 0) & (self.meaning != "depth")
        if sky.any():
            far = np.median(values[good]) / 10.0
            values, good = np.where(sky, far, values), good | sky
        return _fill_nearest(values, good), (f"{bad} of {good.size} depth values were missing and filled in",)

    def _to_depth(self, values: Float64Array) -> Float32Array:
        if self.meaning == "depth":
            return values.astype(np.float32)
        if self.focal is not None and self.baseline is not None and self.meaning == "disparity":
            return np.asarray(self.focal * self.baseline / (values + self.offset), np.float32)
        if self.meaning == "inverse_depth":
            return np.asarray(1.0 / values, np.float32)
        return inverse_to_depth((values + self.offset).astype(np.float32))


def read_depth_values(path: Path) -> Float64Array:
    """Stored values of a one-channel PNG (8 or 16 bits) or an NPY array, [H, W] float64, unscaled.

    Raises:
        BadInput: no such file, not a depth map, or several channels that differ (a colour-mapped picture of a depth).
    """
    if not path.is_file():
        raise BadInput(f"depth file '{path}' does not exist", "a PNG or NPY file", "check the path")
    if path.suffix.lower() not in (".png", ".npy"):
        raise BadInput(f"depth file '{path.name}'", "PNG (8 or 16 bits) or NPY", "convert it, without loss")
    values = read_npy(path) if path.suffix.lower() == ".npy" else read_png(path)
    if values.ndim == 3 and bool((values == values[..., :1]).all()):
        values = values[..., 0]
    if values.ndim != 2 or values.size == 0:
        raise BadInput(
            f"depth file '{path}' of shape {values.shape}",
            "one channel, [H, W]",
            "export the depth itself, not a colour-mapped picture of it",
        )
    return values.astype(np.float64)


def _fill_nearest(values: Float64Array, good: NDArray[np.bool_]) -> Float64Array:
    """Every bad value replaced by the nearest good one."""
    rows, columns = distance_transform_edt(~good, return_distances=False, return_indices=True)
    return np.asarray(values[rows, columns])
