"""What the agreement tests share: scenes from a photograph, and the float64 oracle of an image."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from skimage import data

from orca.anchors import GaussianAnchors
from orca.camera import Camera
from orca.config import RenderConfig, get_preset
from orca.conventions import Float32Array, Float64Array, pixel_grid
from orca.field.decoders import Decoders
from orca.pipeline import reconstruct
from orca.priors.depth import DepthEstimate
from orca.render import HitList
from orca.render.reference import render_rays
from orca.scene import Scene

MODES = {
    "layered": RenderConfig(),
    "per hit": RenderConfig(decode="per_hit", window=2),
    "per hit, whole layer": RenderConfig(decode="per_hit", window=-1),
}
_TENSORS = ("means", "log_variances", "quaternions", "opacity_logits", "features")
_CHUNK = 4096


def photo(size: int) -> Float32Array:
    """A photograph, [size, size, 3] in [0, 1]."""
    image = data.astronaut().astype(np.float32) / 255
    return np.asarray(cv2.resize(image, (size, size), interpolation=cv2.INTER_AREA))


def stepped_depth(size: int) -> Float32Array:
    """A floor that comes nearer, and a square in front of it."""
    depth = np.repeat(np.linspace(3, 1.5, size, dtype=np.float32)[:, None], size, axis=1)
    depth[size // 3 : 2 * size // 3, size // 3 : 2 * size // 3] = 1.0
    return depth


@lru_cache(maxsize=4)
def fitted_scene(size: int, mode: str) -> Scene:
    """The photograph through stages 1 and 2, an anchor per four pixels: what rays meet in real use."""
    draft = get_preset("draft")
    config = replace(draft, render=MODES[mode], repair=replace(draft.repair, enabled=False))
    camera = Camera.from_fov(size, size, 60)
    depth = DepthEstimate(stepped_depth(size), "made up", False)
    return reconstruct(photo(size), camera, depth, (camera,), config).scene


def moved(camera: Camera, degrees: float = 8.0, step: float = 0.1) -> Camera:
    """The camera turned to the right by some degrees, and moved to the left and forward."""
    angle = np.radians(degrees)
    pose = np.eye(4)
    pose[:3, :3] = [[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]]
    pose[:3, 3] = [step, 0, -step]
    return replace(camera, world_to_camera=pose @ camera.world_to_camera)


def in_double(anchors: GaussianAnchors) -> GaussianAnchors:
    """The same anchors in float64."""
    return replace(anchors, **{name: getattr(anchors, name).double() for name in _TENSORS})


def decoders_in_double(decoders: Decoders) -> Decoders:
    """A float64 copy of decoders."""
    copy = Decoders(decoders.use_direction)
    copy.load_state_dict(decoders.state_dict())
    return copy.double()


def reference_pixels(
    anchors: GaussianAnchors,
    decoders: Decoders,
    camera: Camera,
    config: RenderConfig,
    hits: HitList,
    rays: NDArray[np.int64] | None = None,
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Colour over the background [R, 3], alpha [R] and depth sum [R] of the torch reference in float64."""
    rays = np.arange(hits.num_rays) if rays is None else rays
    grid, exact, decode = pixel_grid(camera.width, camera.height), in_double(anchors), decoders_in_double(decoders)
    parts = []
    for low in range(0, len(rays), _CHUNK):
        part = rays[low : low + _CHUNK]
        with torch.inference_mode():
            chosen = torch.from_numpy(hits.padded(part))
            rgb, alpha, depth = render_rays(exact, decode, camera, torch.from_numpy(grid[part]), chosen, config)
        parts.append(np.concatenate([rgb.numpy(), alpha.numpy()[:, None], depth.numpy()[:, None]], 1))
    out = np.concatenate(parts)
    return out[:, :3] + (1 - out[:, 3:4]) * config.background, out[:, 3], out[:, 4]
