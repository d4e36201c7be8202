"""Small inputs for the tests of the stages: cameras, canvases, pictures and depth maps."""

from __future__ import annotations

import numpy as np

from orca.camera import Camera
from orca.stages.canvas import Canvas


def view(
    width: int = 64, height: int = 64, hfov: float = 60.0, x: float = 0.0, z: float = 0.0, y: float = 0.0
) -> Camera:
    """A camera that looks along +z from (x, y, z)."""
    pose = np.eye(4)
    pose[:3, 3] = [-x, -y, -z]
    return Camera.from_fov(width, height, hfov, pose)


def picture(height: int = 64, width: int = 64, seed: int = 0) -> np.ndarray:
    """A smooth picture with some fine texture, within [0.1, 0.9]."""
    random = np.random.default_rng(seed)
    y, x = np.meshgrid(np.linspace(0, 1, height), np.linspace(0, 1, width), indexing="ij")
    waves = [np.sin(2 * np.pi * (random.uniform(1, 4) * x + random.uniform(1, 4) * y + random.random())) for _ in "rgb"]
    noise = random.uniform(-0.1, 0.1, (height, width, 3))
    return (0.5 + 0.3 * np.stack(waves, 2) + noise).astype(np.float32)


def bare_canvas(image: np.ndarray, depth: np.ndarray | None = None, hfov: float = 60.0) -> Canvas:
    """A canvas without margins; depth 1 unless given."""
    height, width = image.shape[:2]
    depth = np.ones((height, width), np.float32) if depth is None else depth
    return Canvas(image, depth, Camera.from_fov(width, height, hfov), (0, 0, 0, 0))


def plane_depth(camera: Camera, normal: np.ndarray, distance: float) -> np.ndarray:
    """z-depth of the plane normal . X = distance at every pixel, [H, W] float64; negative where rays miss it."""
    return distance / (camera.rays() @ normal).reshape(camera.height, camera.width)


def random_depth(height: int, width: int, random: np.random.Generator) -> np.ndarray:
    """A depth map with slopes, steps and outliers, between 0.05 and 50."""
    y, x = np.meshgrid(np.linspace(-1, 1, height), np.linspace(-1, 1, width), indexing="ij")
    log = random.normal() * x + random.normal() * y + random.normal(0, 0.05, (height, width))
    for _ in range(3):
        row, column = random.integers(0, height), random.integers(0, width)
        log[row:, column:] += random.normal()
    return np.clip(np.exp(log), 0.05, 50).astype(np.float32)


def psnr(image: np.ndarray, target: np.ndarray) -> float:
    """PSNR in dB of images in [0, 1]."""
    return float(-10 * np.log10(np.square(image.astype(np.float64) - target).mean()))
