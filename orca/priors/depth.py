"""Depth of the input view: what every estimator returns, the protocol they share, and their names."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol, Self

import numpy as np

from orca.camera import Camera
from orca.conventions import Float32Array
from orca.errors import BadInput
from orca.priors.hub import ModelAccess
from orca.priors.spec import PriorSpec, parse_spec
from orca.registry import Registry

__all__ = [
    "DEPTH_PROVIDERS",
    "DepthEstimate",
    "DepthProvider",
    "clip_outliers",
    "inverse_to_depth",
    "limit_far",
    "parse_depth_spec",
]

FAR_RATIO = 10.0
METRIC_FAR_RATIO = 50.0
OUTLIER_QUANTILES = (0.001, 0.999)


@dataclass(frozen=True, eq=False)
class DepthEstimate:
    """Depth of one image.

    Attributes:
        depth: z-depth, [H, W] float32, positive and finite.
        source: who says so, in words a table can print.
        is_metric: True if ``depth`` is proportional to true depth (the unit may be unknown); False for a guess, or
            for a relative depth whose inverse has an unknown offset.
        hfov_deg: horizontal field of view in degrees, where the provider knows it.
        is_measured: True if it was measured (stereo, a scanner): its edges are trusted and nothing is smoothed.
        notes: what a reader of the result must know.
    """

    depth: Float32Array
    source: str
    is_metric: bool
    hfov_deg: float | None = None
    notes: tuple[str, ...] = ()
    is_measured: bool = False

    def __post_init__(self) -> None:
        depth = np.ascontiguousarray(self.depth, np.float32)
        if depth.ndim != 2 or depth.size == 0:
            raise BadInput(f"depth of shape {depth.shape}", "[H, W]", "check the depth provider")
        bad = int(depth.size - np.count_nonzero(np.isfinite(depth) & (depth > 0)))
        if bad:
            raise BadInput(
                f"depth from '{self.source}': {bad} of {depth.size} values are NaN, infinite or not positive",
                "finite, positive z-depth",
                "repair the depth map, or use another depth provider",
            )
        object.__setattr__(self, "depth", depth)

    def with_notes(self, *notes: str) -> DepthEstimate:
        """The same depth with more notes."""
        return replace(self, notes=self.notes + notes)


class DepthProvider(Protocol):
    """Image in, depth out."""

    @property
    def name(self) -> str:
        """Its name in the registry."""
        ...

    @classmethod
    def from_spec(cls, spec: PriorSpec) -> Self:
        """Build a provider from a parsed specification; raises `BadInput` for a wrong option. Loads nothing heavy."""
        ...

    def estimate(self, image: Float32Array, camera: Camera) -> DepthEstimate:
        """Depth of ``image`` ([H, W, 3] float32 in [0, 1]), same height and width.

        Raises:
            BadInput: the provider's file is broken or does not belong to this image.
            Unavailable: weights are missing.
        """
        ...


DEPTH_PROVIDERS: Registry[type[DepthProvider]] = Registry(
    "depth provider",
    {
        "file": "orca.priors.file:FileDepth",
        "onnx": "orca.priors.onnx:OnnxDepth",
        "heuristic": "orca.priors.heuristic:HeuristicDepth",
        "constant": "orca.priors.heuristic:ConstantDepth",
        "auto": "orca.priors.auto:AutoDepth",
        "depth-pro": "orca.priors.learned:DepthProDepth",
        "depth-anything": "orca.priors.learned:DepthAnythingDepth",
    },
)


def parse_depth_spec(text: str, access: ModelAccess | None = None) -> DepthProvider:
    """Build the depth provider that a one-line specification names; ``access`` is how a learned one gets its weights.

    Examples: ``file:D.png?unit=0.0001&meaning=depth``, ``onnx:small.onnx?size=384&range=255&meaning=inverse_depth``,
    ``heuristic``, ``constant``, ``auto``, ``depth-pro``, ``depth-anything``. Options of each provider: see its class.

    Raises:
        Unknown: no such provider, or no such option.
        BadInput: an option with a wrong value, or a file name is missing.
    """
    spec = replace(parse_spec(text), access=access or ModelAccess())
    return DEPTH_PROVIDERS.get(spec.name).from_spec(spec)


def inverse_to_depth(inverse: Float32Array, far_ratio: float = FAR_RATIO) -> Float32Array:
    """z-depth of relative inverse depth [H, W] >= 0, where 0 (sky) becomes ``far_ratio`` times the median depth.

    Everything nearer keeps 1 / inverse; nothing is farther than that bound.

    Raises:
        BadInput: no value is positive, so there is no scale to speak of.
    """
    positive = inverse[np.isfinite(inverse) & (inverse > 0)]
    if positive.size == 0:
        raise BadInput(
            "an inverse depth without a single positive value",
            "inverse depth > 0 somewhere in the image",
            "check the declared meaning and input range, or use another depth provider",
        )
    floor = np.float32(np.median(positive) / far_ratio)
    return np.asarray(1.0 / np.maximum(inverse, floor), np.float32)


def clip_outliers(values: Float32Array) -> Float32Array:
    """``values`` [H, W] limited to their own 0.1 % and 99.9 % quantiles.

    A network's stray pixels would stretch the whole scene. What is not finite is left alone.
    """
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return values
    low, high = np.quantile(finite, OUTLIER_QUANTILES)
    return np.clip(values, np.float32(low), np.float32(high))


def limit_far(depth: Float32Array) -> tuple[Float32Array, tuple[str, ...]]:
    """Metric depth [H, W] limited to 50 times its median (sky may be 10 km away), and a note if that changed anything.

    True distance beyond that gives no parallax along any path this project renders.
    """
    limit = np.float32(METRIC_FAR_RATIO * float(np.median(depth)))
    beyond = depth > limit
    if not bool(beyond.any()):
        return depth, ()
    note = f"{beyond.mean():.1%} of the pixels lay beyond {METRIC_FAR_RATIO:g} times the median depth: set to that"
    return np.minimum(depth, limit), (note,)
