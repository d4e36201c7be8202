"""The chart's numbers: the front, which scenes count, what has no cost, and the words and files made of them."""

from __future__ import annotations

import csv
import json
import math
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.chart import CHART_COSTS, Chart, build_chart, chart_words, cost_value, panel_words, write_charts
from bench.chart.pareto import beaten_by, pareto_front
from bench.cli import main
from bench.measured import read_runs
from tests.bench.chart_runs import Cell, two_scenes, write_cells

_FEW = st.integers(0, 4).map(float)  # few values, so that ties are common


@given(st.lists(st.tuples(_FEW, _FEW), min_size=1, max_size=12), st.booleans())
def test_the_front_is_what_nothing_beats(points: list[tuple[float, float]], higher: bool) -> None:
    costs, qualities = [c for c, _ in points], [q for _, q in points]
    front = pareto_front(costs, qualities, higher)
    sign = 1 if higher else -1
    for i, (c, q) in enumerate(points):
        beaten = any(d <= c and sign * r >= sign * q and (d, r) != (c, q) for d, r in points)
        assert (i in front) != beaten
        assert bool(beaten_by(i, costs, qualities, higher)) == beaten
    along = [(costs[i], sign * qualities[i]) for i in front]
    assert along == sorted(along)
    assert all(b[1] > a[1] for a, b in pairwise(along) if a != b)


def chart_of(tmp_path: Path, cells: dict[str, dict[str, Cell]]) -> Chart:
    return build_chart(read_runs([write_cells(tmp_path / "run", cells)]))


def test_means_intervals_and_front(tmp_path: Path) -> None:
    panel = chart_of(tmp_path, two_scenes()).of_cost("seconds")[0]
    assert (panel.quality.key, panel.scenes, panel.over) == ("input_psnr", ("a", "b"), "2 scenes")
    by_name = {point.method: point for point in panel.points}
    slow = by_name["orca@anchors=16384"]
    assert slow.cost is not None
    assert (slow.cost.mean, slow.quality.mean) == (4, 25)
    assert 3 <= slow.cost.low < 4 < slow.cost.high <= 5
    assert [point.method for point in panel.front] == ["warp", "orca"]
    assert by_name["vistadream"].cost is None
    assert by_name["vistadream"].published
    assert not by_name["vistadream"].on_front


def test_lower_is_better_turns_the_front_around(tmp_path: Path) -> None:
    panel = next(p for p in chart_of(tmp_path, two_scenes()).of_cost("bytes") if p.quality.key == "niqe")
    assert [point.method for point in panel.front] == ["warp", "orca@anchors=16384", "orca"]


def test_only_scenes_that_every_method_has_are_averaged(tmp_path: Path) -> None:
    cells = two_scenes()
    cells["warp"]["b"] = Cell(fails=True)
    panel = chart_of(tmp_path, cells).of_cost("seconds")[0]
    assert panel.over == "1/2 scenes"
    assert {p.method: p.quality.mean for p in panel.points} == {
        "warp": 19,
        "orca": 29,
        "orca@anchors=16384": 24,
        "vistadream": 23,
    }
    assert all(point.quality.low == point.quality.mean == point.quality.high for point in panel.points)
    assert "Only scenes that every method has a value on are averaged: warp (1 missing)." in panel_words(panel)


def test_what_has_no_panel_is_told_with_its_reason(tmp_path: Path) -> None:
    cells = {
        "warp": {"a": Cell(None, 5, 1)},
        "orca": {"a": Cell(30, 5, 2)},
        "mine": {"b": Cell(20, None, 3)},
    }
    chart = chart_of(tmp_path, cells)
    assert chart.panels == ()
    assert any(note == "No panel of PSNR, input view (dB): no scene on which every method has a value." for note in
               chart.notes)  # fmt: skip
    assert "No panel of NIQE: the same for every method (5.000)." in chart.notes


def test_a_method_without_a_score_is_left_out_with_its_reason(tmp_path: Path) -> None:
    cells = two_scenes()
    cells["warp"] = {scene: Cell(None, 8, 1) for scene in "ab"}
    panel = chart_of(tmp_path, cells).of_cost("seconds")[0]
    assert panel.left_out == (("warp", "does not apply"),)
    assert "warp has no value: does not apply." in panel_words(panel)
    assert panel.scenes == ("a", "b")


def test_costs_of_one_result() -> None:
    timed = Cell(30, 5, 8, 12, 250).record("orca", "a", "fake")
    assert {c.key: cost_value(timed, c.key).number for c in CHART_COSTS} == {
        "seconds": 8,
        "render_ms_per_frame": 80,
        "memory": 250,
        "bytes": 12,
    }
    read = Cell(30, 5).record("vistadream", "a", "fake")
    assert all(cost_value(read, c.key).number is None and cost_value(read, c.key).reason for c in CHART_COSTS)
    older = Cell(30, 5, 8).record("orca", "a", "fake")
    assert cost_value(older, "memory").reason == "not measured on that system, or by an older version"
    failed = Cell(fails=True).record("orca", "a", "fake")
    assert "percentile" in cost_value(failed, "seconds").reason


@pytest.mark.parametrize("adapter", ["splat_methods", "orca_scene"])
def test_rendering_a_finished_scene_is_not_the_cost_of_making_it(adapter: str) -> None:
    import importlib
    import inspect

    source = inspect.getsource(importlib.import_module(f"bench.adapters.{adapter}"))
    assert "elsewhere, which is not timed" in source  # what the chart knows such methods by
    cell = Cell(30, 5, 8, notes=("ply, rendered here; fitted elsewhere, which is not timed",))
    assert cost_value(cell.record("mine", "a", "fake"), "seconds").reason == "fitted elsewhere"
    assert cost_value(cell.record("mine", "a", "fake"), "render_ms_per_frame").number == 80


def test_the_front_in_words(tmp_path: Path) -> None:
    chart = chart_of(tmp_path, two_scenes())
    words = panel_words(chart.of_cost("seconds")[0])
    assert words.startswith(
        "PSNR, input view (dB), higher is better, 2 scenes: 20.00 for 1 s with warp, then 30.00 for 2 s with orca "
        "(+10.00 [+10.00, +10.00])."
    )
    assert "Beaten on both: orca@anchors=16384." in words
    assert "vistadream, published, not measured here: 24.00, which orca reaches for 2 s." in words
    niqe = panel_words(chart.of_cost("seconds")[1])
    assert "vistadream, published, not measured here: 3.500, which nothing measured here reaches." in niqe
    assert chart_words(chart)[0] == "Quality against seconds a scene"


def test_a_gain_that_may_be_chance_is_called_so(tmp_path: Path) -> None:
    cells = {
        "warp": {"a": Cell(20, 8, 1), "b": Cell(30, 9, 1), "c": Cell(25, 9, 1)},
        "orca": {"a": Cell(29, 5, 2), "b": Cell(22, 6, 2), "c": Cell(25, 6, 2)},
    }
    assert "which may be chance" in panel_words(chart_of(tmp_path, cells).of_cost("seconds")[0])


def test_files(tmp_path: Path) -> None:
    chart = build_chart(read_runs([write_cells(tmp_path / "run", two_scenes())]), CHART_COSTS[:1])
    written = write_charts(chart, tmp_path / "a")
    names = {"chart-seconds.png", "chart-seconds.svg"}
    assert {path.name for path in written} == names | {"chart.csv", "chart.md"}
    assert (tmp_path / "a" / "chart-seconds.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    rows = list(csv.DictReader((tmp_path / "a" / "chart.csv").read_text().splitlines()))
    assert len(rows) == 2 * 4
    row = next(r for r in rows if (r["cost"], r["quality"], r["method"]) == ("seconds", "input_psnr", "orca"))
    assert (row["cost_mean"], row["quality_mean"], row["on_front"], row["scenes"]) == ("2", "30", "True", "2")
    assert math.isclose(float(row["quality_low"]), 29)
    published = next(r for r in rows if r["method"] == "vistadream")
    assert (published["cost_mean"], published["why_no_cost"]) == ("", "frames were read, not computed here")
    again = write_charts(chart, tmp_path / "b")
    assert all(a.read_bytes() == b.read_bytes() for a, b in zip(written, again, strict=True))


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = write_cells(tmp_path / "one", {k: v for k, v in two_scenes().items() if k != "warp"})
    other = write_cells(tmp_path / "two", {"warp": two_scenes()["warp"]})
    asked = ["chart", str(run), str(other), "--metrics", "niqe", "--costs", "seconds", "--json"]
    assert main(asked) == 0
    document = json.loads(capsys.readouterr().out)
    assert [(p["cost"], p["quality"]) for p in document["panels"]] == [("seconds", "niqe")]
    assert document["panels"][0]["front"] == ["warp", "orca"]
    assert all(Path(file).is_file() and Path(file).parent == run / "chart" for file in document["files"])
    assert "chart-bytes.png" not in {Path(file).name for file in document["files"]}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--metrics", "nique"], "did you mean 'niqe'"),
        (["--costs", "second"], "did you mean 'seconds'"),
    ],
)
def test_wrong_names(tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], words: str) -> None:
    run = write_cells(tmp_path / "run", two_scenes())
    assert main(["chart", str(run), *arguments]) == 2
    assert words in capsys.readouterr().err


def test_nothing_to_draw_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = write_cells(tmp_path / "run", {"vistadream": two_scenes()["vistadream"]})
    assert main(["chart", str(run)]) == 2
    assert "nothing to draw" in capsys.readouterr().err
    assert main(["chart", str(tmp_path / "none")]) == 2
