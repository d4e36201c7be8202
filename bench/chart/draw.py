"""One figure a cost: a panel for every score, better always up, cost on a logarithmic axis."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from bench.chart.labels import Box, place_labels
from bench.chart.panels import ChartPoint, Panel

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw_chart", "family_of", "short_name"]

# Colours of Okabe and Ito, which differ for every kind of colour vision, and a marker each.
_LOOKS = {
    "orca": ("#0072b2", "o", "ORCA; the label says what a point changes"),
    "orca-paper": ("#56b4e9", "o", "ORCA with the paper's lifting"),
    "warp": ("#d55e00", "s", "warp baselines"),
    "published": ("#009e73", "D", "published frames"),
    "other": ("#cc79a7", "^", "other methods"),
}
_STRIP = 0.2  # share of a panel for what has no cost
_DPI = 130


def family_of(point: ChartPoint) -> str:
    """Which of the looks a method has."""
    if point.published:
        return "published"
    base = point.method.partition(" ")[0].partition("@")[0]
    if base in ("orca-paper", "warp", "orca"):
        return base
    return base.partition("-")[0] if base.partition("-")[0] in ("orca", "warp") else "other"


def short_name(method: str) -> str:
    """What stands beside a point: of a point of ORCA what it changes, else the whole name."""
    base, at, changes = method.partition("@")
    return changes.replace("+", ", ") if at and base == "orca" else method


def draw_chart(panels: Sequence[Panel], title: str) -> Figure:
    """The figure of the panels over one cost; there must be at least one."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    columns = 2 if len(panels) == 4 else min(3, len(panels))
    rows = math.ceil(len(panels) / columns)
    figure = Figure(figsize=(5.3 * columns, 4.3 * rows + 0.9), dpi=_DPI, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    laid_out = [_Drawn(panel, axis, _draw_panel(panel, axis)) for panel, axis in zip(panels, axes, strict=False)]
    for axis in axes[len(panels) :]:
        axis.set_visible(False)
    _legend(figure, panels, title)
    canvas.draw()  # lays everything out; names are placed in pixels after it
    figure.set_layout_engine("none")
    for drawn in laid_out:
        _name_points(drawn, canvas.get_renderer())
    return figure


@dataclass(frozen=True)
class _Drawn:
    panel: Panel
    axis: Axes
    places: list[tuple[float, float]]  # of the points, in data coordinates


def _draw_panel(panel: Panel, axis: Axes) -> list[tuple[float, float]]:
    """Everything but the names; returns where each point went."""
    places = _places(panel)
    higher = bool(panel.quality.higher_is_better)
    for point, (x, y) in zip(panel.points, places, strict=True):
        colour, marker, _ = _LOOKS[family_of(point)]
        bars: dict[str, Any] = {"yerr": _error(point.quality)}
        if point.cost is not None:
            bars["xerr"] = _error(point.cost)
        else:
            axis.axhline(y, color=colour, linewidth=0.8, linestyle=(0, (1, 3)), zorder=1)
        axis.errorbar(x, y, **bars, fmt="none", ecolor=colour, elinewidth=0.9, alpha=0.55, zorder=2)
        face = colour if point.on_front or point.cost is None else "white"
        axis.plot(x, y, marker, color=colour, markerfacecolor=face, markersize=7, markeredgewidth=1.6, zorder=4)
    front = panel.front
    axis.step(
        [p.cost.mean for p in front if p.cost is not None],
        [p.quality.mean for p in front],
        where="post",
        color="#444444",
        linewidth=1.2,
        zorder=3,
    )
    _scales(panel, axis, higher)
    return places


def _error(stat: Any) -> list[list[float]]:
    return [[max(0.0, stat.mean - stat.low)], [max(0.0, stat.high - stat.mean)]]


def _places(panel: Panel) -> list[tuple[float, float]]:
    """Points without a cost stand side by side in the strip at the left edge."""
    low, _, strip_end = _limits(panel)
    without = [point for point in panel.points if point.cost is None]
    places = []
    for point in panel.points:
        if point.cost is not None:
            places.append((point.cost.mean, point.quality.mean))
        else:
            share = (without.index(point) + 0.5) / len(without)
            places.append((low * (strip_end / low) ** share, point.quality.mean))
    return places


def _limits(panel: Panel) -> tuple[float, float, float]:
    """Left and right end of the axis, and where the strip ends (the left end where there is none)."""
    costs = [point.cost for point in panel.points if point.cost is not None]
    floor = 1e-3 * max(stat.high for stat in costs) or 1e-6  # a logarithmic axis knows no zero
    first = max(min(stat.low for stat in costs), floor)
    last = max(max(stat.high for stat in costs), floor)
    margin = max((last / first) ** 0.09, 1.15)
    first, last = first / margin, last * margin**1.6  # names mostly stand at the right
    if all(point.cost is not None for point in panel.points):
        return first, last, first
    return first / (last / first) ** (_STRIP / (1 - _STRIP)), last, first


def _scales(panel: Panel, axis: Axes, higher: bool) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    low, high, strip_end = _limits(panel)
    axis.set_xscale("log")
    axis.set_xlim(low, high)
    locator = LogLocator(subs=(1.0, 2.0, 5.0) if high / strip_end < 200 else (1.0,))
    ticks = [float(v) for v in locator.tick_values(strip_end, high) if strip_end <= v <= high]
    axis.set_xticks(ticks)
    axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.xaxis.set_minor_locator(NullLocator())
    axis.margins(y=0.14)
    axis.autoscale(enable=True, axis="y")
    if not higher:
        axis.invert_yaxis()
    axis.grid(color="#dddddd", linewidth=0.6, zorder=0)
    axis.set_axisbelow(True)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)
    better = "higher is better" if higher else "lower is better, axis upside down"
    axis.set_title(f"{panel.quality.title}: {better} ({panel.over})", fontsize=9.5, loc="left")
    axis.set_xlabel(f"{panel.cost.title}, logarithmic", fontsize=9)
    axis.tick_params(labelsize=8.5)
    if strip_end > low:
        axis.axvspan(low, strip_end, color="#f0f0f0", zorder=0)


def _legend(figure: Figure, panels: Sequence[Panel], title: str) -> None:
    from matplotlib.lines import Line2D

    families = {family_of(point) for panel in panels for point in panel.points}
    handles = [
        Line2D([], [], color=colour, marker=marker, linestyle="none", markersize=7, label=label)
        for family, (colour, marker, label) in _LOOKS.items()
        if family in families
    ]
    handles.append(
        Line2D([], [], color="#444444", linewidth=1.2, label="front: nothing is cheaper and better (filled)")
    )
    figure.suptitle(f"{title}. Better is up, cheaper is left; bars: 95 % over scenes.", fontsize=11)
    figure.legend(handles=handles, loc="outside lower center", ncols=min(3, len(handles)), fontsize=8.5, frameon=False)


def _name_points(drawn: _Drawn, renderer: Any) -> None:
    """Put the names, and lines to those that had to stand away from their points."""
    from matplotlib.patheffects import AbstractPathEffect, withStroke

    panel, axis = drawn.panel, drawn.axis
    halo: list[AbstractPathEffect] = [
        withStroke(linewidth=2.2, foreground="white", alpha=0.85)
    ]  # a line behind a name stays legible
    texts = [
        axis.text(0, 0, short_name(p.method), fontsize=7.8, color=_dark(_LOOKS[family_of(p)][0]), zorder=6)
        for p in panel.points
    ]
    strip = _strip_caption(panel, axis)
    boxes = [text.get_window_extent(renderer) for text in texts]
    pixels = [tuple(float(v) for v in axis.transData.transform(place)) for place in drawn.places]
    area = axis.get_window_extent(renderer)
    bounds: Box = (area.x0 + 2, area.y0 + 2, area.x1 + 12, area.y1 - 2)
    obstacles = [] if strip is None else [_box(strip.get_window_extent(renderer))]
    reach = 9.0 * _DPI / 100
    centres = [(p[0], p[1]) for p in pixels]
    lines = _line_boxes(panel, drawn.places, axis)
    placed = place_labels(centres, [(b.width, b.height) for b in boxes], bounds, obstacles, lines, reach)
    back = axis.transData.inverted()
    for text, box, point, family in zip(texts, placed, centres, map(family_of, panel.points), strict=True):
        text.set_position(tuple(back.transform((box[0], box[1]))))
        text.set_verticalalignment("bottom")
        text.set_path_effects(halo)
        near = (min(max(point[0], box[0]), box[2]), min(max(point[1], box[1]), box[3]))
        if math.hypot(near[0] - point[0], near[1] - point[1]) > 1.35 * reach:
            ends = back.transform([point, near])
            axis.plot(ends[:, 0], ends[:, 1], color=_LOOKS[family][0], linewidth=0.6, alpha=0.7, zorder=3)


def _line_boxes(panel: Panel, places: Sequence[tuple[float, float]], axis: Axes) -> list[Box]:
    """Error bars, the front and the levels of what has no cost, as thin boxes in pixels."""
    spans: list[tuple[float, float, float, float]] = []
    low, high, _ = _limits(panel)
    for point, (x, y) in zip(panel.points, places, strict=True):
        spans.append((x, point.quality.low, x, point.quality.high))
        spans.append((low, y, high, y) if point.cost is None else (point.cost.low, y, point.cost.high, y))
    front = [(p.cost.mean, p.quality.mean) for p in panel.front if p.cost is not None]
    for (x, y), (next_x, next_y) in pairwise(front):
        spans += [(x, y, next_x, y), (next_x, y, next_x, next_y)]
    boxes = []
    for left, bottom, right, top in spans:
        (x0, y0), (x1, y1) = axis.transData.transform([(max(left, low), bottom), (max(right, low), top)])
        boxes.append((min(x0, x1) - 1.0, min(y0, y1) - 1.0, max(x0, x1) + 1.0, max(y0, y1) + 1.0))
    return boxes


def _strip_caption(panel: Panel, axis: Axes) -> Any:
    without = [point for point in panel.points if point.cost is None]
    if not without:
        return None
    if all(point.published for point in without):
        words = "published,\nnot measured\nhere"
    else:
        words = "no model" if panel.cost.key == "bytes" else "not measured\nhere"
    return axis.text(
        0.5 * _STRIP, 0.015, words, transform=axis.transAxes, fontsize=7, style="italic", color="#555555", ha="center"
    )


def _box(extent: Any) -> Box:
    return float(extent.x0), float(extent.y0), float(extent.x1), float(extent.y1)


def _dark(colour: str) -> str:
    """The colour at 70 %, to be read as text on white."""
    return "#" + "".join(f"{int(int(colour[i : i + 2], 16) * 0.7):02x}" for i in (1, 3, 5))
