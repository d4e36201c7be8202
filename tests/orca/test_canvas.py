"""The canvas of stage 1: the original stays, its camera projects as before, its size follows the trajectory."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orca.camera import Camera
from orca.config import CanvasConfig
from orca.priors.outpaint import OUTPAINTERS, extend_depth
from orca.stages.canvas import make_canvas, needed_margins
from tests.orca.stage_inputs import picture, random_depth, view

WIDTH, HEIGHT = 60, 44
FOCAL = 0.5 * WIDTH / math.tan(math.radians(30))
UNLIMITED = 100.0


def flat(depth: float = 4.0) -> np.ndarray:
    return np.full((HEIGHT, WIDTH), depth, np.float32)


def turned(degrees: float) -> Camera:
    """The input camera turned about the vertical axis; positive looks to the right."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    pose = np.eye(4)
    pose[:3, :3] = [[c, 0, -s], [0, 1, 0], [s, 0, c]]
    return Camera.from_fov(WIDTH, HEIGHT, 60, pose)


@pytest.mark.parametrize("name", ["mean", "mirror", "edge", "classical"])
def test_inside_the_canvas_the_original_is_kept_bit_for_bit(name: str) -> None:
    image, depth = picture(HEIGHT, WIDTH), random_depth(HEIGHT, WIDTH, np.random.default_rng(1))
    path = [view(WIDTH, HEIGHT, x=1.0), view(WIDTH, HEIGHT, x=-0.3, z=-0.5)]
    canvas = make_canvas(image, depth, view(WIDTH, HEIGHT), path, CanvasConfig(), OUTPAINTERS.get(name)())
    left, top, right, bottom = canvas.margins
    assert min(canvas.margins) > 0
    assert canvas.image.shape == (HEIGHT + top + bottom, WIDTH + left + right, 3)
    assert canvas.depth.shape == canvas.image.shape[:2] == (canvas.camera.height, canvas.camera.width)
    np.testing.assert_array_equal(canvas.image[canvas.original], image)
    np.testing.assert_array_equal(canvas.depth[canvas.original], depth)
    assert (canvas.depth > 0).all()


def test_an_outpainter_that_repaints_the_original_is_overruled() -> None:
    class Painter:
        name = "painter"

        def outpaint(self, image: np.ndarray, left: int, top: int, right: int, bottom: int) -> np.ndarray:
            return np.full((image.shape[0] + top + bottom, image.shape[1] + left + right, 3), 0.25, np.float32)

    image = picture(HEIGHT, WIDTH)
    canvas = make_canvas(image, flat(), view(WIDTH, HEIGHT), [view(WIDTH, HEIGHT, x=1.0)], CanvasConfig(), Painter())
    np.testing.assert_array_equal(canvas.image[canvas.original], image)
    assert (canvas.image[:, WIDTH:] == 0.25).all()


def test_without_an_outpainter_the_canvas_is_the_image() -> None:
    image, depth, camera = picture(HEIGHT, WIDTH), flat(), view(WIDTH, HEIGHT)
    canvas = make_canvas(image, depth, camera, [view(WIDTH, HEIGHT, x=5.0)], CanvasConfig(), None)
    assert canvas.margins == (0, 0, 0, 0)
    assert canvas.camera is camera
    np.testing.assert_array_equal(canvas.image[canvas.original], image)


@pytest.mark.parametrize("name", ["mean", "mirror", "edge", "classical"])
def test_depth_is_extended_like_the_colours(name: str) -> None:
    depth = random_depth(HEIGHT, WIDTH, np.random.default_rng(2))
    path = [view(WIDTH, HEIGHT, x=2.0)]
    canvas = make_canvas(
        picture(HEIGHT, WIDTH), depth, view(WIDTH, HEIGHT), path, CanvasConfig(), OUTPAINTERS.get(name)()
    )
    by_mode = {mode: extend_depth(depth, *canvas.margins, mode=mode) for mode in ("mirror", "edge")}
    assert not np.array_equal(by_mode["mirror"], by_mode["edge"])
    # what an outpainter invents has no depth to mirror
    np.testing.assert_array_equal(canvas.depth, by_mode["mirror" if name in ("mean", "mirror") else "edge"])


@settings(max_examples=20, deadline=None)
@given(st.floats(-2, 2), st.floats(-1, 1), st.floats(-0.9, 0.9), st.floats(0.5, 20))
def test_canvas_camera_projects_like_the_original_plus_margins(x: float, y: float, lateral: float, z: float) -> None:
    camera = view(WIDTH, HEIGHT)
    canvas = make_canvas(
        picture(HEIGHT, WIDTH),
        flat(),
        camera,
        [view(WIDTH, HEIGHT, x=lateral)],
        CanvasConfig(),
        OUTPAINTERS.get("edge")(),
    )
    left, top, *_ = canvas.margins
    points = np.array([[x, y, z]])
    np.testing.assert_allclose(canvas.camera.project(points)[0], camera.project(points)[0] + [left, top], atol=1e-9)


def test_a_trajectory_that_stays_needs_no_margins() -> None:
    camera = view(WIDTH, HEIGHT)
    assert needed_margins(camera, [camera] * 3, flat(), UNLIMITED) == (0, 0, 0, 0)
    assert needed_margins(camera, [view(WIDTH, HEIGHT, z=0.5)], flat(), UNLIMITED) == (0, 0, 0, 0)  # moves closer


def test_margins_of_known_motions() -> None:
    """A step of dx shows f dx / z pixels more on that side; a step back by dz widens both sides by z' / z."""
    camera = view(WIDTH, HEIGHT)
    assert needed_margins(camera, [view(WIDTH, HEIGHT, x=0.5)], flat(4), UNLIMITED) == (
        0, 0, math.ceil(FOCAL * 0.5 / 4), 0,
    )  # fmt: skip
    # Seen from 1 behind, the far depth 4 lies at z = 3 of the input: border at centre +- half * 4 / 3.
    back = needed_margins(camera, [view(WIDTH, HEIGHT, z=-1)], flat(4), UNLIMITED)
    assert back == (WIDTH // 6, math.ceil(HEIGHT / 6), WIDTH // 6, math.ceil(HEIGHT / 6))
    # Turned right by 10 degrees: the right border is at tan(30 + 10) degrees.
    right = needed_margins(camera, [turned(10)], flat(), UNLIMITED)[2]
    assert right == math.ceil(FOCAL * math.tan(math.radians(40)) - WIDTH / 2)


@settings(max_examples=25, deadline=None)
@given(st.floats(0, 1.5), st.floats(1, 3), st.booleans())
def test_margins_grow_with_the_motion(step: float, factor: float, to_the_right: bool) -> None:
    sign = 1 if to_the_right else -1
    small = needed_margins(view(WIDTH, HEIGHT), [view(WIDTH, HEIGHT, x=sign * step)], flat(), UNLIMITED)
    large = needed_margins(view(WIDTH, HEIGHT), [view(WIDTH, HEIGHT, x=sign * step * factor)], flat(), UNLIMITED)
    assert all(a <= b for a, b in zip(small, large, strict=True))
    assert small[0 if to_the_right else 2] == 0


def test_margins_serve_every_view_of_the_trajectory() -> None:
    camera, right, left = view(WIDTH, HEIGHT), view(WIDTH, HEIGHT, x=0.6), view(WIDTH, HEIGHT, x=-0.2)
    alone = [needed_margins(camera, [v], flat(), UNLIMITED) for v in (right, left)]
    assert needed_margins(camera, [right, left], flat(), UNLIMITED) == tuple(np.max(alone, axis=0))


@pytest.mark.parametrize("max_scale", [1.0, 1.5, 2.5])
def test_the_canvas_is_never_larger_than_max_scale(max_scale: float) -> None:
    path = [view(WIDTH, HEIGHT, x=x, z=-2) for x in (-50, 50)]
    left, top, right, bottom = needed_margins(view(WIDTH, HEIGHT), path, flat(), max_scale)
    assert WIDTH + left + right <= max_scale * WIDTH
    assert HEIGHT + top + bottom <= max_scale * HEIGHT
    assert left == right == (max_scale - 1) / 2 * WIDTH


def test_what_lies_behind_the_input_camera_asks_for_no_margin() -> None:
    assert needed_margins(view(WIDTH, HEIGHT), [turned(180)], flat(), UNLIMITED) == (0, 0, 0, 0)
