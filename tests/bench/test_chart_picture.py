"""The chart as a picture: names that do not cover one another, looks that do not depend on colour alone."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.chart import build_chart
from bench.chart.draw import draw_chart, family_of, short_name
from bench.chart.labels import Box, overlap, place_labels
from bench.chart.panels import ChartPoint, Stat
from bench.measured import read_runs
from tests.bench.chart_runs import Cell, write_cells

_BOUNDS: Box = (0, 0, 700, 500)
_PLACES = st.tuples(st.floats(20, 680), st.floats(20, 480))


@settings(deadline=None, max_examples=40)
@given(st.lists(_PLACES, min_size=1, max_size=14), st.integers(30, 140))
def test_names_keep_off_one_another(points: list[tuple[float, float]], width: int) -> None:
    boxes = place_labels(points, [(float(width), 14.0)] * len(points), _BOUNDS)
    for i, a in enumerate(boxes):
        assert a[0] >= 0 and a[1] >= 0 and a[2] <= 700 and a[3] <= 500  # noqa: PT018
        assert math.isclose(a[2] - a[0], width)
        assert all(overlap(a, b) == 0 for b in boxes[:i])


def test_a_lone_name_stands_at_the_right_and_avoids_a_line_there() -> None:
    place = [(100.0, 100.0)]
    assert place_labels(place, [(60, 10)], _BOUNDS)[0][0] > 100
    line = (100.0, 99.0, 700.0, 101.0)
    assert overlap(place_labels(place, [(60, 10)], _BOUNDS, lines=[line])[0], line) == 0
    wall = (0.0, 0.0, 700.0, 99.0)
    assert place_labels(place, [(60, 10)], _BOUNDS, obstacles=[wall])[0][1] >= 99


def test_a_name_wider_than_the_panel_is_still_placed() -> None:
    assert place_labels([(50, 50)], [(900, 10)], _BOUNDS)[0][0] == 0


@pytest.mark.parametrize(
    ("method", "family", "short"),
    [
        ("orca", "orca", "orca"),
        ("orca@anchors=16384+repair=off", "orca", "anchors=16384, repair=off"),
        ("orca-norepair", "orca", "orca-norepair"),
        ("orca-paper@hits=4", "orca-paper", "orca-paper@hits=4"),
        ("warp-telea", "warp", "warp-telea"),
        ("orca (quality)", "orca", "orca (quality)"),
        ("mine", "other", "mine"),
    ],
)
def test_families_and_names(method: str, family: str, short: str) -> None:
    stat = Stat.of([1.0])
    assert family_of(ChartPoint(method, stat, stat)) == family
    assert family_of(ChartPoint(method, None, stat, published=True)) == "published"
    assert short_name(method) == short


def test_a_crowded_chart(tmp_path: Path) -> None:
    """Twelve methods near one another: every name is there, inside its panel, and on no other name."""
    names = [f"orca@anchors={n}" for n in (1024, 4096, 16384, 65536, 262144)]
    names += ["orca@repair=off", "orca@hits=4", "orca@decode=per_hit", "orca", "warp", "warp-telea"]
    cells = {
        name: {s: Cell(30 + 0.3 * k + j, 5 - 0.02 * k, 10 * 1.06**k, 10 + k % 3, 300) for j, s in enumerate("ab")}
        for k, name in enumerate(names)
    }
    cells["vistadream"] = {s: Cell(31.0, 4.9) for s in "ab"}
    chart = build_chart(read_runs([write_cells(tmp_path / "run", cells)]))
    panels = chart.of_cost("seconds")
    figure = draw_chart(panels, "title")
    renderer = figure.canvas.get_renderer()
    for axis in figure.axes[: len(panels)]:
        texts = [text for text in axis.texts if "published" not in text.get_text()]
        assert {text.get_text() for text in texts} == {short_name(name) for name in cells}
        extents = [text.get_window_extent(renderer) for text in texts]
        boxes = [(e.x0, e.y0, e.x1, e.y1) for e in extents]
        assert all(overlap(a, b) == 0 for i, a in enumerate(boxes) for b in boxes[:i])
        assert any("published" in text.get_text() for text in axis.texts)
    inverted = [axis.yaxis_inverted() for axis in figure.axes[: len(panels)]]
    assert inverted == [not panel.quality.higher_is_better for panel in panels]
    assert all(axis.get_xscale() == "log" for axis in figure.axes[: len(panels)])
