"""The chart of the page: the panels of `bench.chart`, so that page and picture show the same numbers."""

from __future__ import annotations

from typing import Any

from bench.chart import CHART_COSTS, build_chart
from bench.chart.draw import short_name
from bench.chart.files import chart_document
from bench.measured import Measured

__all__ = ["chart_data"]


def chart_data(run: Measured) -> dict[str, Any]:
    """Panels with means, intervals, fronts and their words, and what the axes are called; JSON-ready."""
    chart = build_chart(run)
    panels = chart_document(chart)["panels"]
    for panel in panels:
        for point in panel["points"]:
            point["short"] = short_name(point["method"])
    qualities = {panel.quality.key: panel.quality for panel in chart.panels}
    costs = [cost for cost in CHART_COSTS if chart.of_cost(cost.key)]
    return {
        "panels": panels,
        "qualities": [{"key": c.key, "title": c.title, "decimals": c.decimals} for c in qualities.values()],
        "costs": [{"key": c.key, "title": c.title, "decimals": c.decimals} for c in costs],
    }
