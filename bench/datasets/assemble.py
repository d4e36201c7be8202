"""From an image and a depth map to a checked scene case: shared by the data sets."""

from __future__ import annotations

import difflib
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bench.datasets.case import SceneCase
from bench.trajectories import build_trajectory, evenly_spaced
from orca.camera import Camera
from orca.conventions import Float32Array, UInt8Array, to_float
from orca.errors import BadInput, Unknown
from orca.paths import scene_radius

__all__ = [
    "DEFAULT_TRAJECTORY",
    "check_scene",
    "checked_depth",
    "default_camera",
    "guessed_depth",
    "in_scene_radii",
    "uncalibrated_case",
]

DEFAULT_HFOV_DEG = 60.0
# 99 frames, so that the 50 evaluated ones are exactly every second one and all steps are equal.
DEFAULT_TRAJECTORY = "spiral"


def default_camera(image: UInt8Array) -> Camera:
    """The camera that is taken for an image [H, W, 3] of which nothing is known: 60 degrees wide."""
    return Camera.from_fov(image.shape[1], image.shape[0], DEFAULT_HFOV_DEG)


def uncalibrated_case(
    dataset: str,
    scene: str,
    image: UInt8Array,
    camera: Camera,
    depth: Float32Array,
    depth_source: str,
    trajectory: str,
    *,
    depth_is_metric: bool = False,
) -> SceneCase:
    """The case of an image with `default_camera`: no true views, 50 evaluated frames evenly over the named path."""
    path = build_trajectory(trajectory, camera)
    return SceneCase(
        dataset=dataset,
        name=scene,
        image=image,
        camera=camera,
        depth=depth,
        depth_source=depth_source,
        depth_is_metric=depth_is_metric,
        fov_source=f"configured: {DEFAULT_HFOV_DEG:g} degrees",
        trajectory=path,
        eval_indices=evenly_spaced(len(path)),
    )


def check_scene(scene: str, scenes: Sequence[str], dataset: str) -> str:
    """Return ``scene`` if the data set has it; raise `Unknown` with the nearest name if not."""
    if scene not in scenes:
        near = difflib.get_close_matches(scene, scenes, n=1, cutoff=0.5)
        fix = f"did you mean '{near[0]}'?" if near else f"choose a scene of '{dataset}'"
        raise Unknown(f"unknown scene '{scene}' of data set '{dataset}'", ", ".join(scenes), fix)
    return scene


def checked_depth(depth: NDArray[np.generic], image: UInt8Array, where: str) -> Float32Array:
    """The depth map as float32; raises `BadInput` if it is not one positive finite number per pixel of ``image``."""
    if depth.shape != image.shape[:2]:
        raise BadInput(
            f"depth map {where} of shape {depth.shape} for an image of {image.shape[1]}x{image.shape[0]} pixels",
            f"one channel of shape {image.shape[:2]}",
            "resize the depth map to the image (nearest), or use its own image",
        )
    if depth.dtype.kind not in "uif":
        raise BadInput(f"depth map {where} of type {depth.dtype}", "unsigned integers or floats", "convert it")
    values = depth.astype(np.float32)
    wrong = ~(np.isfinite(values) & (values > 0))
    if wrong.any():
        y, x = np.argwhere(wrong)[0]
        raise BadInput(
            f"depth map {where} has {int(wrong.sum())} pixels that are not positive and finite, "
            f"the first at x={x}, y={y} ({values[y, x]:g})",
            "a positive finite z-depth at every pixel",
            "fill the invalid pixels, for instance with the nearest valid one",
        )
    return values


def in_scene_radii(depth: Float32Array, camera: Camera) -> tuple[Float32Array, float]:
    """The depth map in scene radii, and R in its old unit."""
    radius = scene_radius(depth, camera)
    return (depth / radius).astype(np.float32), radius


def guessed_depth(image: UInt8Array, camera: Camera) -> tuple[Float32Array, str]:
    """The weight-free heuristic's z-depth in scene radii, and its name: a guess, and called one."""
    from orca.priors.heuristic import HeuristicDepth

    estimate = HeuristicDepth().estimate(to_float(image), camera)
    depth, _ = in_scene_radii(checked_depth(estimate.depth, image, "of the heuristic"), camera)
    return depth, estimate.source
