"""Depth of the input view: what every estimator returns, the protocol they share, and their names."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol, Self

import numpy as np

from orca.camera import Camera
from orca.conventions import Float32Array
from orca.errors import BadInput
from orca.priors.spec import PriorSpec, parse_spec
from orca.registry import Registry

__all__ = ["DEPTH_PROVIDERS", "DepthEstimate", "DepthProvider", "inverse_to_depth", "parse_depth_spec"]

FAR_RATIO = 10.0


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
    },
)


def parse_depth_spec(text: str) -> DepthProvider:
    """Build the depth provider that a one-line specification names.

    Examples: ``file:D.png?unit=0.0001&meaning=depth``, ``onnx:small.onnx?size=384&range=255&meaning=inverse_depth``,
    ``heuristic``, ``constant``. Options of each provider: see its class.

    Raises:
        Unknown: no such provider, or no such option.
        BadInput: an option with a wrong value, or a file name is missing.
    """
    spec = parse_spec(text)
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
