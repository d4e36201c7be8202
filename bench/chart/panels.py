"""The numbers of a chart: which scenes count, means and intervals over them, and the front."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import fmean

from bench.chart.costs import CHART_COSTS, cost_value, published_here
from bench.chart.pareto import pareto_front
from bench.measured import Column, Measured
from bench.stats import bootstrap_interval

__all__ = ["Chart", "ChartPoint", "Panel", "Stat", "build_chart"]


@dataclass(frozen=True)
class Stat:
    """A mean over scenes.

    Attributes:
        mean: over ``values``.
        low, high: 95 % bootstrap interval; both the mean where there is one scene, which has none.
        values: scene by scene, in the order of `Panel.scenes`.
    """

    mean: float
    low: float
    high: float
    values: tuple[float, ...]

    @staticmethod
    def of(values: Sequence[float]) -> Stat:
        """Mean and interval of one value or more."""
        mean = fmean(values)
        low, high = bootstrap_interval(values) if len(values) > 1 else (mean, mean)
        return Stat(mean, low, high, tuple(values))


@dataclass(frozen=True)
class ChartPoint:
    """One method in one panel.

    Attributes:
        method: its name in the run.
        cost: None where nothing was measured.
        quality: the score.
        why_no_cost: the reason; empty where there is a cost.
        published: the frames are published ones.
        on_front: no other method with a cost beats it.
    """

    method: str
    cost: Stat | None
    quality: Stat
    why_no_cost: str = ""
    published: bool = False
    on_front: bool = False


@dataclass(frozen=True)
class Panel:
    """One score against one cost.

    Attributes:
        cost, quality: the axes.
        points: methods in the run's order.
        scenes: those on which every method of the panel has a score; means are over these and no others.
        total: how many scenes the runs have.
        left_out: (method, reason) of those without a score on any scene.
        incomplete: (method, how many scenes it has no score on) of those that kept scenes out of the means.
    """

    cost: Column
    quality: Column
    points: tuple[ChartPoint, ...]
    scenes: tuple[str, ...]
    total: int
    left_out: tuple[tuple[str, str], ...] = ()
    incomplete: tuple[tuple[str, int], ...] = ()

    @property
    def front(self) -> tuple[ChartPoint, ...]:
        """The points on the front, cheapest first."""
        return tuple(sorted((p for p in self.points if p.on_front), key=lambda p: _mean_cost(p)))

    @property
    def over(self) -> str:
        """ "11 scenes", or "9/11 scenes" where some had to be left out."""
        count = len(self.scenes)
        words = str(count) if count == self.total else f"{count}/{self.total}"
        return f"{words} scene{'' if words == '1' else 's'}"


@dataclass(frozen=True)
class Chart:
    """Everything that is drawn.

    Attributes:
        dataset: its name.
        panels: one for each pair of cost and score.
        notes: scores and costs that have no panel and why; what the runs were.
    """

    dataset: str
    panels: tuple[Panel, ...]
    notes: tuple[str, ...]

    def of_cost(self, key: str) -> tuple[Panel, ...]:
        """The panels over one cost."""
        return tuple(panel for panel in self.panels if panel.cost.key == key)


def build_chart(
    run: Measured, costs: Sequence[Column] = CHART_COSTS, qualities: Sequence[Column] | None = None
) -> Chart:
    """The panels of one or more runs (see `bench.measured.read_runs`).

    A score gets a panel where at least two methods have it, they differ, and one of them has the cost.

    Args:
        run: what was measured.
        costs: of `bench.chart.costs.CHART_COSTS`.
        qualities: metrics; all that have a better direction when left out.
    """
    chosen = run.columns if qualities is None else qualities
    panels: list[Panel] = []
    missing: dict[str, list[str]] = {}  # reason -> what has no panel because of it
    for quality in (column for column in chosen if column.higher_is_better is not None):
        scored = _scored(run, quality)
        if isinstance(scored, str):
            missing.setdefault(scored, []).append(quality.title)
            continue
        for cost in costs:
            panel = _with_cost(run, scored, cost)
            if any(point.cost is not None for point in panel.points):
                panels.append(panel)
            else:
                missing.setdefault(panel.points[0].why_no_cost, []).append(f"{quality.title} against {cost.title}")
    notes = [f"No panel of {', '.join(what)}: {reason}." for reason, what in missing.items()]
    order = {cost.key: k for k, cost in enumerate(costs)}
    panels.sort(key=lambda panel: order[panel.cost.key])
    return Chart(run.dataset, tuple(panels), (*notes, *run.caption))


def _scored(run: Measured, quality: Column) -> Panel | str:
    """A panel without costs, or why there is none."""
    values = {m: {s: run.value(m, s, quality.key) for s in run.scenes} for m in run.methods}
    known = {m: {s: v.number for s, v in row.items() if v.number is not None} for m, row in values.items()}
    drawn = [method for method in run.methods if known[method]]
    left_out = tuple(
        (m, next((v.reason or v.word for v in values[m].values()), "not run")) for m in run.methods if not known[m]
    )
    if len(drawn) < 2:
        reasons = "; ".join(dict.fromkeys(reason for _, reason in left_out))
        return f"fewer than two methods have a value{f' ({reasons})' if reasons else ''}"
    scenes = tuple(scene for scene in run.scenes if all(scene in known[method] for method in drawn))
    if not scenes:
        return "no scene on which every method has a value"
    points = tuple(
        ChartPoint(m, None, Stat.of([known[m][scene] for scene in scenes]), published=published_here(m)) for m in drawn
    )
    if len({point.quality.mean for point in points}) == 1:
        return f"the same for every method ({points[0].quality.mean:.{quality.decimals}f})"
    missing = tuple((m, len(run.scenes) - len(known[m])) for m in drawn if len(known[m]) < len(run.scenes))
    return Panel(CHART_COSTS[0], quality, points, scenes, len(run.scenes), left_out, missing)


def _with_cost(run: Measured, panel: Panel, cost: Column) -> Panel:
    points = []
    for point in panel.points:
        values = [cost_value(run.records[point.method, scene], cost.key) for scene in panel.scenes]
        numbers = [value.number for value in values if value.number is not None]
        if len(numbers) == len(values):
            points.append(replace(point, cost=Stat.of(numbers)))
        else:
            points.append(replace(point, why_no_cost=next(v.reason for v in values if v.number is None)))
    return _with_front(replace(panel, cost=cost, points=tuple(points)))


def _with_front(panel: Panel) -> Panel:
    timed = [point for point in panel.points if point.cost is not None]
    costs = [_mean_cost(point) for point in timed]
    front = pareto_front(costs, [p.quality.mean for p in timed], bool(panel.quality.higher_is_better))
    best = {timed[i].method for i in front}
    return replace(panel, points=tuple(replace(p, on_front=p.method in best) for p in panel.points))


def _mean_cost(point: ChartPoint) -> float:
    if point.cost is None:
        raise ValueError(f"{point.method} has no cost")
    return point.cost.mean
