"""Points of a sweep: what their names mean, what they refuse, and that they are methods like any other."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from bench.adapters import METHODS, RunOptions, open_methods
from bench.adapters.orca import ORCA
from bench.adapters.points import KNOBS, SWEEP, Overrides, is_point, split_point
from bench.cli import main
from bench.commands.sweep import sweep_methods
from bench.datasets.synthetic import Synthetic
from orca.config import ReconstructConfig, get_preset
from orca.errors import BadInput, Unknown

DRAFT = get_preset("draft")


def changed(text: str, pixels: int | None = 512 * 512, base: ReconstructConfig = DRAFT) -> dict[str, Any]:
    """What a point changes in a preset: dotted name -> new value."""
    return dict(_differences(base.to_json(), split_point(f"orca@{text}")[1].applied(base, pixels).to_json(), ""))


def _differences(a: dict[str, Any], b: dict[str, Any], head: str) -> list[tuple[str, Any]]:
    found: list[tuple[str, Any]] = []
    for key in a:
        if isinstance(a[key], dict):
            found += _differences(a[key], b[key], f"{head}{key}.")
        elif a[key] != b[key]:
            found.append((f"{head}{key}", b[key]))
    return found


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("anchors=16384", {"planar.anchors_per_pixel": 0.0625}),
        ("target_psnr=36.5", {"growth.target_psnr": 36.5}),
        ("max_anchors=9000", {"growth.max_anchors": 9000}),
        ("price=0.05", {"growth.price": 0.05}),
        ("placement=grid", {"planar.placement.kind": "grid"}),
        ("placement=quadtree", {"planar.placement.kind": "quadtree"}),
        ("placement=growth", {}),
        ("hits=8", {"render.max_hits": 8}),
        ("decode=per_hit", {"render.decode": "per_hit", "render.window": 2}),
        ("decode=layered", {}),
        ("solver_steps=1", {"planar.gauss_newton_steps": 1}),
        ("iterations=50", {"deform.max_iterations": 50}),
        ("repair=off", {"repair.enabled": False}),
        ("repair=on", {}),
        ("repair=plain", {"repair.fill": "paper"}),
        ("views=3", {"repair.views": 3}),
        ("canvas=off", {"canvas.outpainter": "none", "canvas.max_scale": 1.0}),
        ("canvas=1.5", {"canvas.max_scale": 1.5}),
        ("spread=even", {"repair.spread": "even"}),
        ("anchors=16384+repair=off", {"planar.anchors_per_pixel": 0.0625, "repair.enabled": False}),
    ],
)
def test_each_knob_changes_what_it_says_and_nothing_else(text: str, expected: dict[str, Any]) -> None:
    assert changed(text) == expected


def test_a_random_start_trains_in_both_stages() -> None:
    found = changed("iterations=50", base=get_preset("paper"))
    assert found == {"planar.max_iterations": 50, "deform.max_iterations": 50}


def test_every_knob_is_tested_and_described() -> None:
    growth = {"target_psnr", "max_anchors", "price"}
    counts = {"anchors", "hits", "solver_steps", "iterations", "views"}
    others = {"preset", "placement", "decode", "repair", "spread", "canvas"}
    assert set(KNOBS) == growth | counts | others
    assert all(knob.allowed and knob.what for knob in KNOBS.values())


@pytest.mark.parametrize(
    ("text", "kind", "words"),
    [
        ("orca@ancors=5", Unknown, "did you mean 'anchors'"),
        ("orca@anchors=few", BadInput, "a whole number from 64"),
        ("orca@anchors=63", BadInput, "a whole number from 64"),
        ("orca@hits=0", BadInput, "from 1 to 4096"),
        ("orca@decode=fast", BadInput, "layered or per_hit"),
        ("orca@repair=", BadInput, "each key once"),
        ("orca@repair=maybe", BadInput, "on, off or plain"),
        ("orca@canvas=0.5", BadInput, "off, or a number from 1 to 10"),
        ("orca@canvas=nan", BadInput, "off, or a number from 1 to 10"),
        ("orca@price=0", BadInput, "a positive number"),
        ("orca@target_psnr=inf", BadInput, "a positive number"),
        ("orca@preset=best", BadInput, "draft, quality or paper"),
        ("orca@", BadInput, "BASE@key=value"),
        ("orca@hits=4+hits=5", BadInput, "for the second time"),
        ("warp@hits=4", Unknown, "orca, orca-paper"),
        ("nothing@hits=4", Unknown, "orca, orca-paper"),
    ],
)
def test_what_is_refused(text: str, kind: type[BadInput], words: str) -> None:
    assert is_point(text)
    with pytest.raises(kind) as caught:
        METHODS.get(text)
    assert words in str(caught.value)


def test_a_point_split_at_commas_is_explained(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "--methods", "orca@anchors=16384,repair=off"]) == 2
    assert "orca@anchors=16384+repair=off" in capsys.readouterr().err
    assert not is_point("mine=frames:some@where")


def test_the_version_follows_the_constants_and_the_name() -> None:
    options = RunOptions()
    names = ("orca", "orca@anchors=16384", "orca@anchors=16385", "orca@hits=4", "orca@preset=quality")
    versions = [method.version(options) for method in open_methods(names, METHODS).values()]
    assert len(set(versions)) == len(names)
    assert versions[0] == ORCA.version(options)
    quality = replace(options, preset="quality")
    assert METHODS.get("orca@preset=quality").version(options).split(",")[1] == ORCA.version(quality).split(",")[1]
    paper = METHODS.get("orca-paper@hits=4")
    assert (paper.name, "relative lifting" in paper.version(options)) == ("orca-paper@hits=4", True)


def test_the_default_sweep_holds_what_it_should() -> None:
    assert len(SWEEP) >= 6
    assert set(sweep_methods("realmdreamer")) >= {*SWEEP, "warp", "warp-telea", "vistadream"}
    assert "vistadream" not in sweep_methods("photos")
    axes = {key for name in SWEEP if "@" in name for key, _ in split_point(name)[1].values}
    assert axes >= {"anchors", "hits", "decode", "iterations", "repair", "canvas", "target_psnr", "price", "placement"}
    assert all(METHODS.get(name).name == name for name in SWEEP)


def test_anchors_are_counted_on_the_image(tmp_path: Path) -> None:
    case = Synthetic(size=64).load("predictable-00")
    method = METHODS.get("orca@anchors=512+repair=off+canvas=off")
    output = method.run(case, RunOptions(work_dir=tmp_path))
    assert output.model["anchors"] + output.model["pruned"] == pytest.approx(512, rel=0.1)
    assert output.model["overrides"] == {"anchors": 512, "repair": "off", "canvas": 1.0}
    assert output.model["repairs"] == 0
    assert json.loads(json.dumps(output.model["overrides"])) == output.model["overrides"]


def test_overrides_start_from_their_own_preset() -> None:
    assert Overrides.parse("preset=quality+hits=4", "orca@...").preset == "quality"
    assert Overrides.parse("hits=4", "orca@...").preset is None
