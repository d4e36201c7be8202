"""Speed against accuracy: every method of one or more runs as a point, one panel a score, the Pareto front drawn."""

from bench.chart.costs import CHART_COSTS, cost_value
from bench.chart.files import write_charts
from bench.chart.panels import Chart, ChartPoint, Panel, Stat, build_chart
from bench.chart.words import chart_words, panel_words

__all__ = [
    "CHART_COSTS",
    "Chart",
    "ChartPoint",
    "Panel",
    "Stat",
    "build_chart",
    "chart_words",
    "cost_value",
    "panel_words",
    "write_charts",
]
