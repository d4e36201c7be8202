"""Observations: the original as it is, and the margin only where it lies outside the original."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from orca.priors.outpaint import extend_depth
from orca.stages.canvas import Canvas
from orca.stages.observations import observations
from tests.orca.stage_inputs import bare_canvas, picture, view

margin = st.integers(0, 37)


def padded_canvas(left: int, top: int, right: int, bottom: int) -> Canvas:
    """A canvas whose original is white and whose margin is black, 24 rows by 31 columns inside."""
    image = np.pad(np.ones((24, 31, 3), np.float32), ((top, bottom), (left, right), (0, 0)))
    depth = extend_depth(np.ones((24, 31), np.float32), left, top, right, bottom)
    return Canvas(image, depth, view(31, 24).padded(left, top, right, bottom), (left, top, right, bottom))


def test_without_margins_the_original_is_all_there_is() -> None:
    canvas = bare_canvas(picture(20, 30))
    (only,) = observations(canvas, 4.0)
    np.testing.assert_array_equal(only.colour, canvas.image.reshape(-1, 3))
    np.testing.assert_array_equal(only.rays, np.arange(600))
    np.testing.assert_array_equal(only.camera.K, canvas.camera.K)


@settings(max_examples=60, deadline=None)
@given(margin, margin, margin, margin, st.floats(1, 12))
def test_margin_rays_never_meet_the_original(left: int, top: int, right: int, bottom: int, spacing: float) -> None:
    canvas = padded_canvas(left, top, right, bottom)
    first, *others = observations(canvas, spacing)
    original = view(31, 24)
    np.testing.assert_allclose(first.camera.K, original.K, atol=1e-12)
    assert (first.camera.width, first.camera.height) == (31, 24)
    assert (first.colour == 1).all()
    assert len(others) == (1 if left + top + right + bottom else 0)
    for other in others:
        points = other.camera.unproject(
            other.camera.project(other.camera.rays())[0][other.rays], np.ones(len(other.rays))
        )
        x, y = original.project(points)[0].T
        assert not ((x > 0) & (x < 31) & (y > 0) & (y < 24)).any()
        assert other.colour.max(initial=0) < 1.1e-3  # nothing of the white original is mixed in
        assert other.colour.shape == (len(other.rays), 3)


def test_the_margin_at_full_resolution_is_the_canvas_outside_the_original() -> None:
    canvas = padded_canvas(5, 0, 3, 7)
    canvas.image[...] = picture(31, 39)
    _, margin_view = observations(canvas, 2.0)  # half of 2 pixels: every pixel
    outside = np.ones((31, 39), bool)
    outside[canvas.original] = False
    np.testing.assert_array_equal(margin_view.rays, np.flatnonzero(outside))
    np.testing.assert_array_equal(margin_view.colour, canvas.image[outside])


def test_a_coarser_margin_has_fewer_rays_of_the_same_view() -> None:
    canvas = padded_canvas(20, 20, 20, 20)
    fine, coarse = observations(canvas, 2.0)[1], observations(canvas, 8.0)[1]
    assert 10 < len(fine.rays) / len(coarse.rays) < 25  # 4 x 4 pixels to one, less at the rim of the original
    assert coarse.camera.hfov_deg == fine.camera.hfov_deg
