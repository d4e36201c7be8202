"""The front of every panel as a sentence: what to take at which price, what is beaten, what was published."""

from __future__ import annotations

from bench.chart.costs import COST_WORDS
from bench.chart.panels import Chart, ChartPoint, Panel, Stat
from bench.measured import Column
from bench.stats import paired_test

__all__ = ["chart_words", "cost_text", "panel_words"]

_UNITS = {"seconds": "s", "render_ms_per_frame": "ms", "memory": "MB", "bytes": "MB"}


def chart_words(chart: Chart) -> list[str]:
    """A heading a cost, a paragraph a panel, then the notes."""
    lines: list[str] = []
    for key in dict.fromkeys(panel.cost.key for panel in chart.panels):
        lines += [
            f"Quality against {COST_WORDS[key]}",
            *(f"  {panel_words(panel)}" for panel in chart.of_cost(key)),
            "",
        ]
    return [*lines, *chart.notes]


def panel_words(panel: Panel) -> str:
    """The front from the cheapest on, each step with its gain over the one before and that gain's 95 % interval."""
    better = "higher" if panel.quality.higher_is_better else "lower"
    sentences = [f"{panel.quality.title}, {better} is better, {panel.over}: {_front(panel)}."]
    beaten = [p.method for p in panel.points if p.cost is not None and not p.on_front]
    if beaten:
        sentences.append(f"Beaten on both: {', '.join(beaten)}.")
    sentences += [_uncosted(panel, point) for point in panel.points if point.cost is None]
    for method, reason in panel.left_out:
        sentences.append(f"{method} has no value: {reason}.")
    if panel.incomplete:
        words = ", ".join(f"{method} ({count} missing)" for method, count in panel.incomplete)
        sentences.append(f"Only scenes that every method has a value on are averaged: {words}.")
    return " ".join(sentences)


def cost_text(cost: Column, stat: Stat) -> str:
    """ "3.21 s": three digits, and the unit."""
    return f"{stat.mean:.3g} {_UNITS[cost.key]}" if stat.mean < 1000 else f"{stat.mean:.0f} {_UNITS[cost.key]}"


def _front(panel: Panel) -> str:
    steps: list[str] = []
    before: ChartPoint | None = None
    for point in panel.front:
        text = f"{_value(panel, point)} for {_cost(panel, point)} with {point.method}"
        steps.append(text if before is None else f"{text} ({_gain(panel, before, point)})")
        before = point
    return ", then ".join(steps)


def _gain(panel: Panel, before: ChartPoint, point: ChartPoint) -> str:
    """ "+1.20 [0.80, 1.61]"; what zero is in the interval of is told so."""
    digits = panel.quality.decimals
    test = paired_test(before.quality.values, point.quality.values)
    if test.low is None or test.high is None:
        return f"{test.difference:+.{digits}f}"
    holds = "" if test.beyond_interval else ", which may be chance"
    return f"{test.difference:+.{digits}f} [{test.low:+.{digits}f}, {test.high:+.{digits}f}]{holds}"


def _uncosted(panel: Panel, point: ChartPoint) -> str:
    """Where a method without a cost would stand: the cheapest point of the front that is at least as good."""
    what = "published, not measured here" if point.published else f"not measured here ({point.why_no_cost})"
    sign = 1 if panel.quality.higher_is_better else -1
    level = sign * point.quality.mean
    reached = next((p for p in panel.front if sign * p.quality.mean >= level), None)
    value = _value(panel, point)
    if reached is None:
        return f"{point.method}, {what}: {value}, which nothing measured here reaches."
    return f"{point.method}, {what}: {value}, which {reached.method} reaches for {_cost(panel, reached)}."


def _value(panel: Panel, point: ChartPoint) -> str:
    return f"{point.quality.mean:.{panel.quality.decimals}f}"


def _cost(panel: Panel, point: ChartPoint) -> str:
    return "nothing known" if point.cost is None else cost_text(panel.cost, point.cost)
