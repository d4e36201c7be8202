"""What `bench stability` found: degenerate inputs that crashed, or went through in silence."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch

from orca.camera import Camera
from orca.config import CanvasConfig
from orca.errors import BadInput, Unavailable
from orca.field.decoders import analytic_decoders
from orca.priors.depth import DepthEstimate
from orca.priors.outpaint import MirrorOutpainter
from orca.priors.spec import PriorSpec
from orca.repair.insert import InsertConfig, features_for_colours
from orca.stages.canvas import Canvas, make_canvas
from tests.orca.anchor_scenes import random_anchors, random_camera


class Outpainter:
    """Answers with whatever it was made of."""

    name = "mine"

    def __init__(self, answer: Callable[[np.ndarray], np.ndarray]) -> None:
        self.answer = answer

    def outpaint(self, image: np.ndarray, left: int, top: int, right: int, bottom: int) -> np.ndarray:
        return self.answer(np.pad(image, ((top, bottom), (left, right), (0, 0))))


def raises(image: np.ndarray) -> np.ndarray:
    raise RuntimeError("out of\nluck")


def not_here(image: np.ndarray) -> np.ndarray:
    raise Unavailable("no weights", "weights", "get them")


def canvas_with(outpainter: Outpainter | MirrorOutpainter, depth: Depth | None = None) -> Canvas:
    image = np.random.default_rng(0).random((32, 32, 3)).astype(np.float32)
    camera = Camera.from_fov(32, 32, 60.0)
    pose = np.eye(4)
    pose[0, 3] = -0.5
    views = (camera, Camera(camera.K, pose, 32, 32))
    return make_canvas(image, np.ones((32, 32), np.float32), camera, views, CanvasConfig(), outpainter, depth)


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (raises, "RuntimeError: out of luck"),
        (lambda image: image * np.float32(np.nan), "not finite"),
        (lambda image: image[::2], "returned shape"),
    ],
)
def test_an_outpainter_that_fails_is_replaced_and_named(answer: Callable[[np.ndarray], np.ndarray], words: str) -> None:
    failed, mirrored = canvas_with(Outpainter(answer)), canvas_with(MirrorOutpainter())
    np.testing.assert_array_equal(failed.image, mirrored.image)
    np.testing.assert_array_equal(failed.depth, mirrored.depth)
    assert failed.margins[2] > 0
    assert "'mine' failed" in failed.note
    assert words in failed.note
    assert mirrored.note == ""


def test_colours_out_of_range_are_clipped() -> None:
    canvas = canvas_with(Outpainter(lambda image: image * 100 - 50))
    assert canvas.note == ""
    assert canvas.image.min() >= 0
    assert canvas.image.max() <= 1


def test_missing_weights_are_the_users_affair() -> None:
    with pytest.raises(Unavailable, match="no weights"):
        canvas_with(Outpainter(not_here))


class Depth:
    """A depth model that answers with whatever it was made of."""

    name = "mine"

    def __init__(self, answer: Callable[[np.ndarray], np.ndarray]) -> None:
        self.answer = answer

    @classmethod
    def from_spec(cls, spec: PriorSpec) -> Depth:
        return cls(raises)

    def estimate(self, image: np.ndarray, camera: Camera) -> DepthEstimate:
        return DepthEstimate(self.answer(np.ascontiguousarray(image[..., 0]) + np.float32(1)), "mine", False)


def wrong_kind(image: np.ndarray) -> np.ndarray:
    raise IndexError("index 3 is out of bounds")


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (wrong_kind, "IndexError: index 3"),
        (lambda image: image[::2, ::2], "depth of shape"),
        (lambda image: -image, "not positive"),
    ],
)
def test_a_depth_model_that_fails_leaves_the_extended_depth(
    answer: Callable[[np.ndarray], np.ndarray], words: str
) -> None:
    invented = canvas_with(Outpainter(lambda image: image), Depth(answer))
    without = canvas_with(Outpainter(lambda image: image))
    np.testing.assert_array_equal(invented.depth, without.depth)
    assert "because mine failed" in invented.margin_depth
    assert words in invented.margin_depth


def test_a_repair_of_which_nothing_may_be_inserted() -> None:
    decoders = analytic_decoders(15.0, torch.Generator().manual_seed(0))
    existing = random_anchors(0, 5, random_camera(0))
    features = features_for_colours(np.zeros((0, 3), np.float32), existing, decoders, InsertConfig(0.5, 2e-3))
    assert features.shape == (0, existing.features.shape[1])


def stretched(pose: np.ndarray) -> None:
    pose[0, :3] *= 1.01


def mirrored(pose: np.ndarray) -> None:
    pose[0, :3] *= -1


def projective(pose: np.ndarray) -> None:
    pose[3, 0] = 0.1


@pytest.mark.parametrize("spoil", [stretched, mirrored, projective])
def test_a_pose_that_is_not_rigid_is_refused(spoil: Callable[[np.ndarray], None]) -> None:
    pose = np.eye(4)
    spoil(pose)
    with pytest.raises(BadInput, match="rigid"):
        Camera.from_fov(32, 32, 60.0, pose)


def test_a_pose_of_few_digits_is_accepted() -> None:
    angle = np.radians(33.3)
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    assert Camera.from_fov(32, 32, 60.0, pose.round(4)).width == 32
