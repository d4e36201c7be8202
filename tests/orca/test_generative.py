"""Generative repair of one region: crop and paste, depth and its alignment, and every way to fail."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from orca.camera import Camera
from orca.errors import BadInput, Unavailable
from orca.priors.depth import DepthEstimate
from orca.repair.components import Component, connected_components
from orca.repair.donors import FillTarget, local_fill
from orca.repair.generative import GenerativeFailed, GenerativeFill, GenerativePriors, generative_fill
from orca.repair.generative_config import GenerativeConfig
from orca.repair.rules import RepairRules

H, W = 120, 160
CAMERA = Camera.from_fov(W, H, 60)
CONFIG = GenerativeConfig(context=30, blend=4)


def scene() -> tuple[np.ndarray, np.ndarray]:
    """A tilted wall, bluer to the right."""
    y, x = np.mgrid[0:H, 0:W]
    rgb = np.stack([np.full((H, W), 0.3), 0.2 + 0.5 * y / H, 0.2 + 0.6 * x / W], 2)
    return rgb.astype(np.float32), (3 + x / W + 0.5 * y / H).astype(np.float32)


def box(y0: int, y1: int, x0: int, x1: int) -> np.ndarray:
    hole = np.zeros((H, W), bool)
    hole[y0:y1, x0:x1] = True
    return hole


HOLES = {"inside": box(40, 80, 60, 110), "at the border": box(0, 60, 100, W), "a whole side": box(0, H, 0, 70)}


class Painter:
    """An inpainter that does what it is told; keeps what it was given."""

    name = "painter"

    def __init__(self, paint: Callable[[np.ndarray, np.ndarray], Any]) -> None:
        self.paint, self.seen = paint, []

    def inpaint(self, image: np.ndarray, mask: np.ndarray) -> np.ndarray:
        self.seen.append((image.copy(), mask.copy()))
        return self.paint(image, mask)


class Depther:
    """A depth provider whose answer is a function of the true depth of the crop."""

    name = "depther"

    def __init__(self, answer: Callable[[np.ndarray], Any], is_metric: bool = True) -> None:
        self.answer, self.is_metric, self.seen = answer, is_metric, []

    @classmethod
    def from_spec(cls, spec: Any) -> Depther:
        raise NotImplementedError

    def estimate(self, image: np.ndarray, camera: Camera) -> DepthEstimate:
        self.seen.append((image.copy(), camera))
        pixels = CAMERA.project(camera.unproject(_corners(camera), np.ones(1)))[0][0].round().astype(int)
        truth = scene()[1][pixels[1] : pixels[1] + camera.height, pixels[0] : pixels[0] + camera.width]
        return DepthEstimate(np.asarray(self.answer(truth), np.float32), "test", self.is_metric)


def _corners(camera: Camera) -> np.ndarray:
    return np.zeros((1, 2))


def orange(image: np.ndarray, mask: np.ndarray) -> np.ndarray:
    return np.where(mask[..., None], np.array([0.9, 0.5, 0.1], np.float32), image)


def raising(error: Exception) -> Callable[..., Any]:
    def fail(*_: object) -> None:
        raise error

    return fail


def complete(
    hole: np.ndarray, painter: Painter, depther: Depther | None, config: GenerativeConfig = CONFIG
) -> tuple[GenerativeFill, FillTarget, Component]:
    rgb, depth = scene()
    rgb, depth = rgb.copy(), depth.copy()
    rgb[hole], depth[hole] = 0, 0
    component = connected_components(hole, 1)[0]
    local = local_fill(rgb, depth, ~hole, component, RepairRules(), scheme="smooth")
    priors = GenerativePriors(painter, depther)
    return generative_fill(rgb, depth, ~hole, component, local, CAMERA, priors, config), local, component


@pytest.mark.parametrize("name", HOLES)
def test_every_hole_pixel_and_no_other_is_filled(name: str) -> None:
    hole = HOLES[name]
    made, _, component = complete(hole, Painter(orange), Depther(lambda z: z))
    filled = np.zeros_like(hole)
    filled[made.target.y, made.target.x] = True
    np.testing.assert_array_equal(filled, hole)
    assert len(made.target.y) == component.area
    np.testing.assert_allclose(made.target.rgb, np.broadcast_to([0.9, 0.5, 0.1], (component.area, 3)), atol=1e-6)
    assert made.target.scheme == "generative:painter+depther"


@pytest.mark.parametrize(
    ("answer", "is_metric", "space", "a", "b"),
    [
        (lambda z: z, True, "depth", 1.0, 0.0),
        (lambda z: (z - 0.5) / 2, True, "depth", 2.0, 0.5),
        (lambda z: 1 / (4 / z + 0.1), False, "inverse_depth", 0.25, -0.025),
    ],
)
@pytest.mark.parametrize("name", HOLES)
def test_depth_is_aligned_and_exact_inside(
    name: str, answer: Callable[[np.ndarray], np.ndarray], is_metric: bool, space: str, a: float, b: float
) -> None:
    hole = HOLES[name]
    made, _, _ = complete(hole, Painter(orange), Depther(answer, is_metric))
    assert made.alignment is not None
    assert made.alignment.space == space
    assert made.alignment.fit.a == pytest.approx(a, rel=1e-3)
    assert made.alignment.fit.b == pytest.approx(b, abs=2e-3)
    assert made.alignment.fit.inlier_share == 1.0
    assert made.alignment.samples == made.target.donors > 100
    assert set(made.alignment.to_json()) == {"a", "b", "inlier_share", "samples", "space"}
    truth = scene()[1][made.target.y, made.target.x]
    error = np.abs(made.target.depth / truth - 1)
    assert np.median(error) < 1e-3
    assert error.max() < 0.06  # at the boundary, where it is the continued background's


def test_depth_at_the_boundary_is_the_continued_background() -> None:
    """Deep inside the prediction rules; at the rim, where it disagrees by a bump, the background does."""

    def bump(z: np.ndarray) -> np.ndarray:
        out = z.copy()
        inner = slice(CONFIG.context, -CONFIG.context)
        out[inner, inner] *= 1.5
        return out

    hole = HOLES["inside"]
    made, local, _ = complete(hole, Painter(orange), Depther(bump))
    rim = (made.target.y == 40) | (made.target.x == 60)
    deep = (np.abs(made.target.y - 60) < 10) & (np.abs(made.target.x - 85) < 10)
    truth = scene()[1][made.target.y, made.target.x]
    assert np.median(made.target.depth[deep] / truth[deep]) == pytest.approx(1.5, rel=0.02)
    assert np.median(made.target.depth[rim] / local.depth[rim]) == pytest.approx(1.05, abs=0.06)


def test_without_a_provider_the_background_goes_on() -> None:
    made, local, _ = complete(HOLES["inside"], Painter(orange), None)
    assert made.alignment is None
    np.testing.assert_array_equal(made.target.depth, local.depth)
    assert made.target.scheme == "generative:painter+continued"


def test_the_inpainter_sees_a_crop_with_context_and_every_unknown_pixel_masked() -> None:
    painter = Painter(orange)
    other = box(50, 55, 112, 118)  # a second hole inside the crop
    rgb, depth = scene()
    hole = HOLES["inside"]
    component = connected_components(hole, 1)[0]
    valid = ~(hole | other)
    rgb[~valid] = np.nan
    local = local_fill(rgb, depth, valid, component, RepairRules())
    depther = Depther(lambda z: z)
    made = generative_fill(rgb, depth, valid, component, local, CAMERA, GenerativePriors(painter, depther), CONFIG)
    image, mask = painter.seen[0]
    assert image.shape == (40 + 60, 50 + 60, 3)
    np.testing.assert_array_equal(mask, ~valid[10:110, 30:140])
    assert np.isfinite(image).all()
    assert len(made.target.y) == component.area  # the other hole is another repair's
    completed, camera = depther.seen[0]
    assert np.isfinite(completed).all()
    assert (camera.width, camera.height) == (110, 100)
    np.testing.assert_allclose(completed[42, 85], [0.9, 0.5, 0.1], atol=1e-6)  # and its depth provider sees no black


def test_a_crop_larger_than_the_limit_is_worked_on_smaller() -> None:
    painter = Painter(orange)
    made, _, component = complete(HOLES["a whole side"], painter, None, GenerativeConfig(max_side=40, context=30))
    image, mask = painter.seen[0]
    assert max(image.shape[:2]) == 40
    assert mask.any()
    assert not mask.all()
    assert len(made.target.y) == component.area
    deep = made.target.x < 60
    np.testing.assert_allclose(made.target.rgb[deep], np.broadcast_to([0.9, 0.5, 0.1], (deep.sum(), 3)), atol=1e-5)


PAINTERS: dict[str, tuple[Callable[[np.ndarray, np.ndarray], Any], str]] = {
    "raises": (raising(RuntimeError("CUDA\n out of memory")), "RuntimeError: CUDA out of memory"),
    "is not available": (raising(Unavailable("no weights", "", "")), "failed: no weights"),
    "refuses": (raising(BadInput("too small", "", "")), "failed: too small"),
    "another size": (lambda image, _: image[:-1], "returned shape"),
    "nothing": (lambda *_: None, "returned shape"),
    "nan": (lambda image, mask: np.where(mask[..., None], np.float32(np.nan), image), "not finite"),
    "all black": (lambda image, mask: np.where(mask[..., None], np.float32(0), image), "nothing but black"),
}
DEPTHERS: dict[str, tuple[Callable[[np.ndarray], Any], str]] = {
    "raises": (raising(ValueError("no depth today")), "ValueError: no depth today"),
    "constant": (lambda z: np.ones_like(z), "constant"),
    "another size": (lambda z: z[:-2], "returned shape"),
    "nan": (lambda z: np.full_like(z, np.nan), "failed"),
    "inverted": (lambda z: 8 - z, "scale of -"),
    "noise": (lambda z: np.random.default_rng(0).uniform(0.1, 90, z.shape), "inliers"),
}


@pytest.mark.parametrize("name", PAINTERS)
def test_every_failure_of_the_inpainter_says_why(name: str) -> None:
    paint, words = PAINTERS[name]
    with pytest.raises(GenerativeFailed) as caught:
        complete(HOLES["inside"], Painter(paint), Depther(lambda z: z))
    assert words in caught.value.given
    assert "\n" not in caught.value.given


@pytest.mark.parametrize("name", DEPTHERS)
def test_every_failure_of_the_depth_says_why(name: str) -> None:
    answer, words = DEPTHERS[name]
    with pytest.raises(GenerativeFailed) as caught:
        complete(HOLES["inside"], Painter(orange), Depther(answer), replace(CONFIG, tolerance=0.01))
    assert words in caught.value.given
    assert "\n" not in caught.value.given


def test_black_is_believed_in_the_dark() -> None:
    rgb, depth = scene()
    hole = HOLES["inside"]
    component = connected_components(hole, 1)[0]
    local = local_fill(rgb * 0.02, depth, ~hole, component, RepairRules())
    black = Painter(PAINTERS["all black"][0])
    made = generative_fill(rgb * 0.02, depth, ~hole, component, local, CAMERA, GenerativePriors(black, None), CONFIG)
    assert made.target.rgb.max() == 0


def test_a_crop_that_shows_nothing_known_is_refused() -> None:
    rgb, depth = scene()
    hole = box(30, 100, 20, 140)
    valid = np.zeros((H, W), bool)
    valid[0, 0] = True  # all that is known lies outside the crop
    component = connected_components(hole, 1)[0]
    local = local_fill(rgb, depth, valid, component, RepairRules())
    config = GenerativeConfig(context=3)
    with pytest.raises(GenerativeFailed, match="nothing of the scene"):
        generative_fill(rgb, depth, valid, component, local, CAMERA, GenerativePriors(Painter(orange)), config)
    valid[:] = False
    valid[29, 19] = True
    small = GenerativeConfig(max_side=16, context=3)
    with pytest.raises(GenerativeFailed, match="resolution"):
        generative_fill(rgb, depth, valid, component, local, CAMERA, GenerativePriors(Painter(orange)), small)


def test_lengths_scale_with_the_side() -> None:
    config = GenerativeConfig()
    assert config.scaled(512, 512) == config
    large = config.scaled(1024, 1024)
    assert (large.context, large.blend, large.max_side, large.max_anchors) == (192, 16, 512, 20_000)
    assert config.scaled(1, 1).context == 1


@pytest.mark.parametrize("change", [{"max_side": 8}, {"context": 0}, {"blend": -1}, {"max_anchors": 0}])
def test_constants_out_of_range_are_refused(change: dict[str, int]) -> None:
    with pytest.raises(BadInput, match="generative repair"):
        GenerativeConfig(**change)
