"""The chart on disk: PNG and SVG a cost, every number as CSV, the fronts in words as Markdown."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

from bench.chart.costs import COST_WORDS
from bench.chart.panels import Chart, Panel, Stat
from bench.chart.words import panel_words
from bench.store import write_atomic
from orca.atomic import atomic_path

__all__ = ["chart_document", "write_charts"]

_HEAD = (
    "cost",
    "quality",
    "higher_is_better",
    "method",
    "cost_mean",
    "cost_low",
    "cost_high",
    "quality_mean",
    "quality_low",
    "quality_high",
    "scenes",
    "scenes_of_run",
    "published",
    "on_front",
    "why_no_cost",
)


def write_charts(chart: Chart, folder: Path) -> list[Path]:
    """Write ``chart-<cost>.png`` and ``.svg``, ``chart.csv`` and ``chart.md``; returns the paths.

    The same chart gives the same bytes of SVG.
    """
    written = []
    for key in dict.fromkeys(panel.cost.key for panel in chart.panels):
        panels = chart.of_cost(key)
        written += _draw(panels, f"{chart.dataset}: quality against {COST_WORDS[key]}", folder, key)
    for name, text in (("chart.csv", _csv(chart)), ("chart.md", _markdown(chart))):
        write_atomic(folder / name, text.encode())
        written.append(folder / name)
    return written


def chart_document(chart: Chart) -> dict[str, Any]:
    """The same as JSON-ready data."""
    return {
        "dataset": chart.dataset,
        "panels": [
            {
                "cost": panel.cost.key,
                "quality": panel.quality.key,
                "higher_is_better": panel.quality.higher_is_better,
                "scenes": list(panel.scenes),
                "scenes_of_run": panel.total,
                "points": [_point(panel, row) for row in range(len(panel.points))],
                "front": [point.method for point in panel.front],
                "left_out": [{"method": method, "reason": reason} for method, reason in panel.left_out],
                "words": panel_words(panel),
            }
            for panel in chart.panels
        ],
        "notes": list(chart.notes),
    }


def _draw(panels: tuple[Panel, ...], title: str, folder: Path, key: str) -> list[Path]:
    from matplotlib import rc_context

    from bench.chart.draw import draw_chart

    paths = [folder / f"chart-{key}{suffix}" for suffix in (".png", ".svg")]
    with rc_context({"svg.hashsalt": "bench chart", "font.family": "DejaVu Sans"}):
        figure = draw_chart(panels, title)
        for path in paths:
            with atomic_path(path) as temporary:
                figure.savefig(temporary, metadata={"Date": None} if path.suffix == ".svg" else None)
    return paths


def _point(panel: Panel, row: int) -> dict[str, Any]:
    point = panel.points[row]
    return {
        "method": point.method,
        **_numbers("cost", point.cost),
        **_numbers("quality", point.quality),
        "published": point.published,
        "on_front": point.on_front,
        "why_no_cost": point.why_no_cost or None,
    }


def _numbers(name: str, stat: Stat | None) -> dict[str, float | None]:
    """Mean and interval; one scene has no interval."""
    ends = (None, None) if stat is None or len(stat.values) < 2 else (stat.low, stat.high)
    return {f"{name}_mean": None if stat is None else stat.mean, f"{name}_low": ends[0], f"{name}_high": ends[1]}


def _csv(chart: Chart) -> str:
    out = io.StringIO()
    writer = csv.DictWriter(out, _HEAD, lineterminator="\n")
    writer.writeheader()
    for panel in chart.panels:
        for row in range(len(panel.points)):
            shared = {
                "cost": panel.cost.key,
                "quality": panel.quality.key,
                "higher_is_better": panel.quality.higher_is_better,
                "scenes": len(panel.scenes),
                "scenes_of_run": panel.total,
            }
            numbers = {k: f"{v:.6g}" if isinstance(v, float) else v for k, v in _point(panel, row).items()}
            writer.writerow(shared | numbers)
    return out.getvalue()


def _markdown(chart: Chart) -> str:
    titles = dict.fromkeys(panel.cost.key for panel in chart.panels)
    parts = [f"# {chart.dataset}: quality against cost"]
    for key in titles:
        panels = chart.of_cost(key)
        parts += [f"## {panels[0].cost.title}", f"![](chart-{key}.png)", *(f"- {panel_words(p)}" for p in panels)]
    if chart.notes:
        parts += ["## Notes", *(f"- {note}" for note in chart.notes)]
    return "\n\n".join(parts) + "\n"
