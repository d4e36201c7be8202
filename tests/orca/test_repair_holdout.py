"""Structure is continued as far as it can be foretold: fully for stripes, not at all for noise."""

from __future__ import annotations

import numpy as np
import pytest

from orca.conventions import Float32Array
from orca.repair.components import BoolArray, connected_components
from orca.repair.donors import local_fill
from orca.repair.holdout import foretold_share
from orca.repair.rules import RepairRules
from orca.repair.structure import ExemplarRules

SIZE = 64
PATCH = ExemplarRules(3, 8)


def stripes() -> Float32Array:
    value = (np.arange(SIZE) // 4 % 2).astype(np.float32)
    return np.repeat(np.tile(value, (SIZE, 1))[..., None], 3, 2)


def noise() -> Float32Array:
    value = np.random.default_rng(0).random((SIZE, SIZE)).astype(np.float32)
    return np.repeat(value[..., None], 3, 2)


def hole() -> BoolArray:
    mask = np.zeros((SIZE, SIZE), bool)
    mask[24:40, 28:38] = True
    return mask


def shares(rgb: Float32Array, trusted: BoolArray | None = None) -> Float32Array:
    background = ~hole() if trusted is None else trusted
    return foretold_share(rgb, np.full((SIZE, SIZE), 0.5, np.float32), background, hole(), PATCH, 1, 12)


def share(rgb: Float32Array, trusted: BoolArray | None = None) -> float:
    return float(shares(rgb, trusted)[hole()].mean())


def test_stripes_are_foretold_and_noise_is_not() -> None:
    assert share(stripes()) == pytest.approx(1.0, abs=0.02)
    # Averaged patches of noise still carry its local mean, so some of what they say holds.
    assert share(noise()) < 0.6


def test_nothing_to_ask_is_nothing_foretold() -> None:
    assert share(stripes(), np.zeros((SIZE, SIZE), bool)) == 0.0
    few = ~hole()
    few[:, 5:] = False
    assert share(stripes(), few) == 0.0


def test_stripes_beside_noise_are_foretold_on_their_side_only() -> None:
    mask = np.zeros((SIZE, SIZE), bool)
    mask[4:60, 28:36] = True
    rgb = np.concatenate([stripes()[: SIZE // 2], noise()[SIZE // 2 :]])
    there = foretold_share(rgb, np.full((SIZE, SIZE), 0.5, np.float32), ~mask, mask, PATCH, 1, 12)
    upper, lower = float(there[8:22, 28:36].mean()), float(there[42:56, 28:36].mean())
    assert upper > lower + 0.15


def test_a_flat_background_departs_from_nothing() -> None:
    there = shares(np.full((SIZE, SIZE, 3), 0.5, np.float32))
    assert 0.0 <= there.min() <= there.max() <= 1.0


@pytest.mark.parametrize(("texture", "bound"), [("stripes", 0.1), ("noise", 1.1)])
def test_a_fill_errs_no_more_than_the_membrane(texture: str, bound: float) -> None:
    rgb = stripes() if texture == "stripes" else noise()
    known = ~hole()
    component = connected_components(hole())[0]
    rules = RepairRules(patch_radius=3, detail_gain=0.0)
    depth = np.full((SIZE, SIZE), 2.0, np.float32)
    errors = {}
    for scheme in ("smooth", "structure"):
        fill = local_fill(np.where(known[..., None], rgb, 0), depth, known, component, rules, scheme)
        errors[scheme] = float(np.square(fill.rgb - rgb[fill.y, fill.x]).mean())
        assert (fill.foretold is None) == (scheme == "smooth")
    assert errors["structure"] <= bound * errors["smooth"]
