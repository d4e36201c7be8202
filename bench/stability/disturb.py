"""Disturbances of what a method is told about a scene, by kind and level; the truth it is measured against stays."""

from __future__ import annotations

import io
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from PIL import Image

from bench.datasets.case import SceneCase, TrueView
from orca.camera import Camera
from orca.conventions import Float32Array, UInt8Array
from orca.errors import Unknown

__all__ = ["DISTURBANCES", "Disturbance", "disturbed", "reduced", "seed_of"]

SEED = "seed"


@dataclass(frozen=True)
class Disturbance:
    """A kind of disturbance.

    Attributes:
        axis: what its level is, for a chart.
        levels: measured levels; the first one disturbs nothing.
        apply: (case, level) -> case.
        share: side of the pictures used, as a share of the original's.
    """

    axis: str
    levels: tuple[float, ...]
    apply: Callable[[SceneCase, float], SceneCase]
    share: float = 0.5


def disturbed(case: SceneCase, kind: str, level: float) -> SceneCase:
    """The case as a method is told it. Its true views are the undisturbed input and every true view of the original.

    Raises:
        Unknown: no such kind.
    """
    if kind not in DISTURBANCES:
        raise Unknown(f"unknown disturbance '{kind}'", ", ".join(DISTURBANCES), "choose one of the list")
    nothing_hidden = np.zeros(case.image.shape[:2], np.bool_)
    truth = (TrueView(case.camera, case.image, nothing_hidden), *case.true_views)
    return replace(DISTURBANCES[kind].apply(case, level), true_views=truth)


def seed_of(kind: str, level: float) -> int:
    """The random seed of a level: the level itself where the seed is what is varied."""
    return int(level) if kind == SEED else 0


def reduced(case: SceneCase, share: float) -> SceneCase:
    """The case with all its pictures at a share of their size: colours by area, depth and masks by the nearest."""
    if share == 1.0:
        return case
    size = (round(case.image.shape[1] * share), round(case.image.shape[0] * share))
    path = case.trajectory
    scale = np.diag([size[0] / path.width, size[1] / path.height, 1.0])
    return replace(
        case,
        image=_smaller(case.image, size),
        camera=case.camera.resized(*size),
        depth=np.asarray(cv2.resize(case.depth, size, interpolation=cv2.INTER_NEAREST_EXACT), np.float32),
        trajectory=replace(path, K=scale @ path.K, width=size[0], height=size[1]),
        true_views=tuple(
            TrueView(
                view.camera.resized(*size),
                _smaller(view.image, size),
                cv2.resize(view.hidden.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST_EXACT) > 0,
            )
            for view in case.true_views
        ),
    )


def _smaller(image: UInt8Array, size: tuple[int, int]) -> UInt8Array:
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def _noise(case: SceneCase, percent: float) -> SceneCase:
    """Depth times smooth log-normal noise (a few pixels wide, as an estimator's error is); it is an estimate now."""
    if percent == 0:
        return case
    field = np.random.default_rng(0).normal(size=case.depth.shape)
    field = cv2.GaussianBlur(field, (0, 0), 3.0)
    field *= math.log1p(percent / 100) / field.std()
    return replace(case, depth=_depth(case.depth * np.exp(field)), depth_is_measured=False)


def _scale(case: SceneCase, factor: float) -> SceneCase:
    """All depths too large by a factor."""
    return replace(case, depth=_depth(case.depth * factor))


def _field_of_view(case: SceneCase, percent: float) -> SceneCase:
    """The method is told a focal length that is off; the cameras that it is judged at are the true ones."""
    K = case.camera.K.copy()
    K[0, 0] *= 1 + percent / 100
    K[1, 1] *= 1 + percent / 100
    return replace(case, camera=Camera(K, case.camera.world_to_camera, case.camera.width, case.camera.height))


def _jpeg(case: SceneCase, quality: float) -> SceneCase:
    """The image as it comes out of a JPEG of this quality; 100 stands for the original."""
    if quality >= 100:
        return case
    file = io.BytesIO()
    Image.fromarray(case.image).save(file, "JPEG", quality=int(quality))
    return replace(case, image=np.array(Image.open(file).convert("RGB")))


def _depth(values: np.ndarray[tuple[int, ...], np.dtype[np.floating]]) -> Float32Array:
    return np.asarray(values, np.float32)


DISTURBANCES: dict[str, Disturbance] = {
    "noise": Disturbance("noise of the depth [%]", (0, 1, 2, 5, 10, 20), _noise),
    "scale": Disturbance("depth over true depth", (1.0, 0.8, 0.9, 1.1, 1.25), _scale),
    "fov": Disturbance("error of the focal length [%]", (0, -10, -5, -2, 2, 5, 10), _field_of_view),
    "jpeg": Disturbance("JPEG quality (100: none)", (100, 90, 75, 50, 25, 10), _jpeg),
    "seed": Disturbance("seed", tuple(range(10)), lambda case, level: case, 1.0),
}
