"""A textured plane seen from the side: novel views must not pay for the fit of the input view.

The plane carries a photograph as a continuous (bilinear) texture; every view's truth is that texture through the exact
homography, averaged over each pixel. The yardstick beside it is what cubic resampling makes of an image of the plane:
nobody who has one image only can know more.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from orca.camera import Camera
from orca.config import get_preset
from orca.conventions import Float32Array, Float64Array
from orca.pipeline import reconstruct
from orca.priors.depth import DepthEstimate
from orca.scene import Scene
from tests.orca.agreement import photo

SIZE = 192
BORDER = 4  # input pixels at the rim of the plane that are not judged
SUB = 4  # samples a pixel, along each axis
ANGLES = (5, 15, 30)


@dataclass(frozen=True)
class View:
    """A camera, what it should see, and where.

    Attributes:
        camera: the camera.
        truth: [SIZE, SIZE, 3].
        judged: pixels that see the plane, away from its rim, [SIZE, SIZE].
        centres: where on the input image the pixel centres fall, [SIZE, SIZE, 2].
    """

    camera: Camera
    truth: Float32Array
    judged: NDArray[np.bool_]
    centres: Float64Array

    def psnr(self, image: Float32Array) -> float:
        error = (np.clip(image, 0, 1) - self.truth)[self.judged]
        return float(-10 * np.log10(np.square(error).mean()))

    def resampled(self, image: Float32Array) -> Float32Array:
        """The input view's image through the homography, cubic."""
        return _sample(image, self.centres, cv2.INTER_CUBIC)


def _sample(image: Float32Array, pixels: Float64Array, how: int) -> Float32Array:
    x, y = np.moveaxis(pixels - 0.5, -1, 0).astype(np.float32)
    return np.asarray(cv2.remap(image, x, y, how, borderMode=cv2.BORDER_REPLICATE), np.float32)


def _on_plane(camera: Camera, sub: int) -> Float64Array:
    """Input-image positions of ``sub`` x ``sub`` points in every pixel, [SIZE * sub, SIZE * sub, 2]: the homography."""
    steps = (np.arange(SIZE * sub) + 0.5) / sub
    pixels = np.stack([axis.ravel() for axis in np.meshgrid(steps, steps)], 1)
    rays, centre = camera.rays(pixels), camera.center
    points = centre + rays * ((1 - centre[2]) / rays[:, 2])[:, None]
    return Camera.from_fov(SIZE, SIZE, 60).project(points)[0].reshape(SIZE * sub, SIZE * sub, 2)


@lru_cache(maxsize=8)
def view(degrees: float) -> View:
    """The plane z = 1 from a camera that went around its middle by some degrees."""
    angle, pose = np.radians(degrees), np.eye(4)
    pose[:3, :3] = [[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]]
    pose[:3, 3] = [0, 0, 1] - pose[:3, :3] @ [0, 0, 1]
    camera = Camera.from_fov(SIZE, SIZE, 60, pose)
    fine = _sample(photo(SIZE), _on_plane(camera, SUB), cv2.INTER_LINEAR)
    centres = _on_plane(camera, 1)
    judged = ((centres > BORDER) & (centres < SIZE - BORDER)).all(-1)
    return View(camera, fine.reshape(SIZE, SUB, SIZE, SUB, 3).mean((1, 3)), judged, centres)


@lru_cache(maxsize=2)
def scene(preset: str) -> Scene:
    """The plane through stages 1 and 2 at constant depth."""
    config = get_preset(preset)
    config = replace(config, repair=replace(config.repair, enabled=False))
    ahead = view(0)
    depth = DepthEstimate(np.ones((SIZE, SIZE), np.float32), "a plane", True)
    return reconstruct(ahead.truth, ahead.camera, depth, (ahead.camera,), config).scene


def test_the_homography_is_that_of_the_cameras() -> None:
    """Straight ahead it is the identity; turned, the middle stays, and what comes nearer is seen larger."""
    grid = np.stack(np.meshgrid(np.arange(SIZE) + 0.5, np.arange(SIZE) + 0.5), -1)
    np.testing.assert_allclose(view(0).centres, grid, atol=1e-9)
    turned = view(30)
    middle = turned.centres[SIZE // 2 - 1 : SIZE // 2 + 1, SIZE // 2 - 1 : SIZE // 2 + 1].mean((0, 1))
    np.testing.assert_allclose(middle, SIZE / 2, atol=0.02)
    heights = turned.centres[-1, :, 1] - turned.centres[0, :, 1]
    assert heights[0] > 1.5 * heights[-1] or heights[-1] > 1.5 * heights[0]
    assert turned.judged.mean() > 0.6


@pytest.mark.slow
@pytest.mark.parametrize("degrees", ANGLES)
def test_a_turned_plane_loses_one_db_at_most(degrees: int) -> None:
    """Preset draft, an anchor per four pixels; and no more than resampling its input view would have lost."""
    ahead, turned, fitted = view(0), view(degrees), scene("draft")
    renderer = fitted.renderer()
    input_view, novel = renderer.render(ahead.camera).rgb, renderer.render(turned.camera)
    assert turned.psnr(novel.rgb) >= ahead.psnr(input_view) - 1.0
    assert turned.psnr(novel.rgb) >= turned.psnr(turned.resampled(input_view)) - 0.75
    assert novel.alpha[turned.judged].min() > 0.95


@pytest.mark.slow
@pytest.mark.parametrize("degrees", ANGLES)
def test_an_exact_fit_turned_is_no_worse_than_the_image_resampled(degrees: int) -> None:
    """Preset quality interpolates the input, so any view loses many dB; as many as the true input image, resampled."""
    ahead, turned, fitted = view(0), view(degrees), scene("quality")
    renderer = fitted.renderer()
    assert ahead.psnr(renderer.render(ahead.camera).rgb) > 50
    novel = renderer.render(turned.camera).rgb
    assert turned.psnr(novel) >= turned.psnr(turned.resampled(ahead.truth)) - 1.0
