"""Presets: the paper's constants as it states them, and plain data out of every configuration."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys

import pytest

from orca.config import PRESETS, HashConfig, ReconstructConfig, RenderConfig, TrainConfig, get_preset
from orca.errors import Unknown


def test_the_presets_are_named_after_themselves() -> None:
    assert set(PRESETS) == {"draft", "quality", "paper"}
    for name, preset in PRESETS.items():
        assert preset.name == name
        assert get_preset(name) is preset
    assert ReconstructConfig() == get_preset("draft")


def test_a_mistyped_preset_is_met_with_the_nearest() -> None:
    with pytest.raises(Unknown, match="did you mean 'paper'"):
        get_preset("papr")
    with pytest.raises(Unknown, match="draft, quality, paper"):
        get_preset("xyzzy")


def test_the_papers_constants() -> None:
    """METHOD.md sections 2 to 4."""
    paper = get_preset("paper")
    assert paper.planar.max_iterations == 30_000
    assert (paper.deform.max_iterations, paper.deform.arm_after) == (20_000, 10_000)
    assert (paper.train.eval_every, paper.train.min_gain_db, paper.train.patience) == (1000, 0.03, 4)
    assert paper.deform.lifting == "relative"
    assert (paper.planar.placement.kind, paper.planar.initialisation) == ("grid", "random")
    assert (paper.deform.sharpen_depth, paper.deform.follow_slope) == (False, False)
    assert (paper.repair.views, paper.repair.fill, paper.repair.spread) == (0, "paper", "even")


def test_the_base_representations_constants() -> None:
    """METHOD.md section 1, marked I."""
    assert (HashConfig().levels, HashConfig().coarsest_resolution, HashConfig().finest_resolution) == (16, 16, 8192)
    growth = (HashConfig().finest_resolution / HashConfig().coarsest_resolution) ** (1 / 15)
    assert growth == pytest.approx(1.5157, abs=1e-4)
    assert HashConfig().initial == 1e-3
    assert RenderConfig().chi2 == 6.25
    render = get_preset("paper").render
    assert (render.decode, render.window) == ("per_hit", 2)
    assert (get_preset("paper").planar.opacity_logit, get_preset("paper").planar.use_direction) == (1.0, True)
    rates = TrainConfig()
    assert (rates.lr_field, rates.lr_field_final, rates.adam_eps) == (1e-2, 1e-4, 1e-15)
    assert (rates.lr_means, rates.lr_log_variances, rates.lr_quaternions, rates.lr_opacity) == (1e-5, 5e-5, 1e-3, 1e-3)


def test_our_defaults_that_measurements_chose() -> None:
    """METHOD.md 1.1: direction off with one camera, layers instead of a window, a random background."""
    draft = get_preset("draft")
    assert (draft.render.decode, draft.planar.use_direction, draft.train.random_background) == ("layered", False, True)
    assert draft.deform.lifting == "metric"


@pytest.mark.parametrize("name", PRESETS)
def test_plain_data_holds_every_value(name: str) -> None:
    preset = get_preset(name)
    document = preset.to_json()
    again = json.loads(json.dumps(document))

    def compare(config: object, plain: object) -> None:
        if dataclasses.is_dataclass(config):
            assert isinstance(plain, dict)
            assert set(plain) == {f.name for f in dataclasses.fields(config)}
            for key, value in plain.items():
                compare(getattr(config, key), value)
        else:
            assert plain == (list(config) if isinstance(config, tuple) else config)

    compare(preset, again)
    assert again["schema_version"] == 1


def test_configurations_are_frozen() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        get_preset("draft").render.chi2 = 1.0  # type: ignore[misc]


def test_changing_the_lifting_changes_nothing_else() -> None:
    draft = get_preset("draft")
    relative = draft.with_lifting("relative")
    assert relative.deform.lifting == "relative"
    assert relative.with_lifting("metric") == draft
    assert draft.deform.lifting == "metric"


def test_importing_the_configuration_is_light() -> None:
    code = "import orca.config, sys; print([m for m in ('torch', 'numba', 'scipy', 'pandas') if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"
