"""Depth of the outpainted margin: estimated on the outpainted image where someone can, else extended."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from orca.camera import Camera
from orca.config import CanvasConfig
from orca.priors.classical import NearestInpainter
from orca.priors.depth import DepthEstimate
from orca.priors.grow import InpaintingOutpainter
from orca.priors.outpaint import MirrorOutpainter, extend_depth
from orca.stages.canvas import Canvas, make_canvas
from tests.orca.stage_inputs import picture, view

W, H = 80, 60
FOCAL = view(W, H).K[0, 0]


def tilted(camera: Camera) -> np.ndarray:
    """Depth of one tilted wall as this camera sees it, whatever its margins."""
    x = (np.arange(camera.width) + 0.5 - camera.K[0, 2]) / camera.K[0, 0]
    return np.tile(4 / (1 - 0.5 * x), (camera.height, 1)).astype(np.float32)


class Estimator:
    name = "estimator"

    def __init__(self, answer: Callable[[np.ndarray], Any], is_metric: bool) -> None:
        self.answer, self.is_metric, self.calls = answer, is_metric, 0

    @classmethod
    def from_spec(cls, spec: Any) -> Estimator:
        raise NotImplementedError

    def estimate(self, image: np.ndarray, camera: Camera) -> DepthEstimate:
        self.calls += 1
        assert image.shape[:2] == (camera.height, camera.width)
        return DepthEstimate(self.answer(tilted(camera)).astype(np.float32), "test", self.is_metric)


def canvas(outpainter: Any, estimator: Estimator | None) -> Canvas:
    camera = view(W, H)
    path = [view(W, H, x=1.5), view(W, H, x=-1.5)]
    return make_canvas(picture(H, W), tilted(camera), camera, path, CanvasConfig(), outpainter, estimator)


GROW = InpaintingOutpainter(NearestInpainter(), "classical")


@pytest.mark.parametrize(
    ("answer", "is_metric"), [(lambda z: z, True), (lambda z: 3 * z - 1, True), (lambda z: 1 / (5 / z + 0.2), False)]
)
def test_the_wall_goes_on(answer: Callable[[np.ndarray], Any], is_metric: bool) -> None:
    made = canvas(GROW, Estimator(answer, is_metric))
    np.testing.assert_array_equal(made.depth[made.original], tilted(view(W, H)))
    truth = tilted(made.camera)
    error = np.abs(made.depth / truth - 1)
    extended = extend_depth(tilted(view(W, H)), *made.margins, mode="edge")
    outside = np.ones(truth.shape, bool)
    outside[made.original] = False
    assert error[outside].mean() < 0.25 * np.abs(extended / truth - 1)[outside].mean()
    assert "estimator on the outpainted image, 100% of the frame" in made.margin_depth


def raising(_: np.ndarray) -> Any:
    raise RuntimeError("no\nmemory")


@pytest.mark.parametrize(
    ("answer", "words"),
    [(raising, "RuntimeError: no memory"), (np.ones_like, "constant"), (lambda z: 20 - z, "scale of -")],
)
def test_an_estimate_that_fails_leaves_the_extended_depth(answer: Callable[[np.ndarray], Any], words: str) -> None:
    made = canvas(GROW, Estimator(answer, True))
    np.testing.assert_array_equal(made.depth, extend_depth(tilted(view(W, H)), *made.margins, mode="edge"))
    assert words in made.margin_depth
    assert "extended from the frame, because estimator failed" in made.margin_depth


def test_a_mirrored_image_takes_its_depth_mirrored() -> None:
    estimator = Estimator(lambda z: z, True)
    made = canvas(MirrorOutpainter(), estimator)
    assert estimator.calls == 0
    np.testing.assert_array_equal(made.depth, extend_depth(tilted(view(W, H)), *made.margins, mode="mirror"))
    assert made.margin_depth == "the original's, extended (mirror)"


def test_the_canvas_is_as_large_as_the_path_needs_and_says_so() -> None:
    made = canvas(GROW, None)
    left, _, right, _ = made.margins
    assert made.scale == (pytest.approx((W + left + right) / W), pytest.approx(made.image.shape[0] / H))
    assert 1 < made.scale[0] <= CanvasConfig().max_scale
    still = make_canvas(picture(H, W), tilted(view(W, H)), view(W, H), [view(W, H)], CanvasConfig(), GROW)
    assert still.scale == (1.0, 1.0)
    assert canvas(None, None).margin_depth == "there is no margin"
