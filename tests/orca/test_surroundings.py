"""What a picture shows where no anchor is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orca.config import RenderConfig, get_preset
from orca.conventions import Float32Array
from orca.render.renderer import Rendering
from orca.render.surroundings import as_shown, push_pull

CONFIG = RenderConfig(background=0.25)


def view(colour: Float32Array, alpha: Float32Array) -> Rendering:
    """A render of ``colour`` [H, W, 3] with coverage ``alpha`` [H, W] over the configured background."""
    rgb = alpha[..., None] * colour + (1 - alpha)[..., None] * np.float32(CONFIG.background)
    return Rendering(rgb.astype(np.float32), alpha, np.ones_like(alpha), 0)


def ramp(height: int, width: int) -> Float32Array:
    x = np.linspace(0.2, 0.8, width, dtype=np.float32)
    return np.repeat(np.stack([x, 1 - x, 0 * x + 0.5], 1)[None], height, 0)


@pytest.mark.parametrize(("height", "width"), [(33, 47), (1, 9), (7, 1), (64, 64), (2, 2)])
def test_one_colour_fills_everything(height: int, width: int) -> None:
    """Whatever is open, and half open: the colour itself, by hand."""
    colour = np.full((height, width, 3), (0.1, 0.6, 0.9), np.float32)
    alpha = np.random.default_rng(0).choice([0.0, 0.5, 1.0], (height, width)).astype(np.float32)
    alpha.flat[0] = 1.0
    shown = as_shown(view(colour, alpha), CONFIG)
    np.testing.assert_allclose(shown.rgb, colour, atol=1e-5)
    assert shown.rgb.dtype == np.float32


def test_pinholes_take_the_colours_around_them() -> None:
    colour, alpha = ramp(60, 80), np.ones((60, 80), np.float32)
    holes = np.zeros((60, 80), bool)
    holes[10:50:8, 12:70:9] = True
    alpha[holes] = 0
    before = view(colour, alpha)
    shown = as_shown(before, CONFIG)
    assert np.abs(before.rgb - colour)[holes].max() > 0.2
    assert np.abs(shown.rgb - colour)[holes].max() < 0.02
    np.testing.assert_array_equal(shown.rgb[~holes], before.rgb[~holes])
    np.testing.assert_array_equal(shown.alpha, before.alpha)  # a hole is still a hole
    np.testing.assert_array_equal(shown.depth, before.depth)


def test_what_is_all_but_covered_stays_as_it_was_fitted() -> None:
    """A fit makes up for the little background that shines through; only what is open beyond that is filled."""
    colour, alpha = ramp(40, 40), np.full((40, 40), 0.9995, np.float32)
    alpha[10:20, 10:20] = 0.4
    before = view(colour, alpha)
    shown = as_shown(before, CONFIG)
    np.testing.assert_array_equal(shown.rgb[alpha > 0.9], before.rgb[alpha > 0.9])
    assert np.abs(shown.rgb - colour)[alpha < 0.9].max() < 0.02


def test_colours_stay_within_those_that_are_there() -> None:
    generator = np.random.default_rng(1)
    colour = generator.random((40, 56, 3), np.float32)
    alpha = (generator.random((40, 56)) < 0.3).astype(np.float32)
    filled = push_pull(colour * alpha[..., None], alpha)
    assert filled.min() >= -1e-6
    assert filled.max() <= 1 + 1e-6


@pytest.mark.parametrize("alpha", [0.0, 1.0])
def test_nothing_to_spread_or_nothing_open_is_left_alone(alpha: float) -> None:
    given = view(ramp(8, 8), np.full((8, 8), alpha, np.float32))
    assert as_shown(given, CONFIG) is given


def test_the_paper_shows_its_background() -> None:
    assert get_preset("paper").render.backdrop == "plain"
    given = view(ramp(8, 8), np.full((8, 8), 0.5, np.float32))
    assert as_shown(given, replace(CONFIG, backdrop="plain")) is given
