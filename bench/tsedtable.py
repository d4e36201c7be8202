"""What a TSED of a run is worth: pooled and per scene, with intervals, nulls and the whole grid of thresholds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import Any

from bench.measured import MISSING, Measured
from bench.metrics.tsed_pooled import pool_fractions
from bench.published import read_published
from bench.record import ScoreRecord
from bench.tableformat import Head, Row, Table, TableCell
from orca.errors import BadInput

__all__ = ["TSED_MODES", "tsed_tables"]

# The two modes are two quantities: each has tables of its own.
TSED_MODES = {"tsed": "known cameras", "epipolar_self_consistency": "geometry estimated from the frames"}
NATIVE = "native"
_NULLS = {"frozen_null": "Frozen null", "shifted_camera_null": "Shifted null"}


def tsed_tables(run: Measured) -> list[Table]:
    """Three tables for each mode that the run has: methods, scenes, and the grid of thresholds.

    Raises:
        BadInput: the run has no TSED at all.
    """
    found = [metric for metric in TSED_MODES if any(_scored(run, method, metric) for method in run.methods)]
    if not found:
        raise BadInput(
            "a run without TSED", f"one with a score of {' or '.join(TSED_MODES)}", "bench run ... --metrics tsed"
        )
    return [table for metric in found for table in (_methods(run, metric), _scenes(run, metric), _grid(run, metric))]


@dataclass(frozen=True)
class _Pooled:
    """A share of consistent pairs over the scenes of one method."""

    text: str
    value: float
    low: float
    high: float
    mean: float
    scenes: int


def _scored(run: Measured, method: str, metric: str) -> dict[str, ScoreRecord]:
    """Scene -> score of the scenes with a value."""
    found = {}
    for scene in run.scenes:
        record = run.records.get((method, scene))
        score = None if record is None else record.scores.get(metric)
        if score is not None and score.value is not None:
            found[scene] = score
    return found


def _pooled(counts: Sequence[tuple[int, int]]) -> _Pooled | None:
    if not any(pairs for _, pairs in counts):
        return None
    p = pool_fractions(counts)
    return _Pooled(f"{p.consistent}/{p.pairs}", p.pooled, p.low, p.high, p.mean, p.scenes)


_METHOD_HEADS = (
    Head("pooled", "Pooled ↑"),
    Head("interval", "Wilson 95 %"),
    Head("pairs", "Pairs"),
    Head("mean", "Mean of scenes ↑"),
    *(Head(key, title) for key, title in _NULLS.items()),
    Head("median_sed", "Median SED [px] ↓"),
    Head("median_flow", "Median flow [px]"),
    Head("no_power", "No power"),
)
_METHOD_NOTES = (
    "Wilson interval of the pooled share; pairs of one scene are not independent: read it as a lower bound.",
    "Nulls, SED and flow: mean over scenes. Frozen null: what a video that never moves would score; shifted null: "
    "what these frames score at the cameras of the next pair.",
    "No power: scenes whose score is within 0.05 of a null: no power at this step size; compare the median SED.",
)


def _methods(run: Measured, metric: str) -> Table:
    rows = tuple(Row((method,), _method_cells(run, _scored(run, method, metric))) for method in run.methods)
    title = f"{run.dataset}: TSED with {TSED_MODES[metric]}"
    notes = (*run.caption, _variant(run, metric), *_METHOD_NOTES)
    return Table(metric, title, ("Method",), _METHOD_HEADS, rows, notes)


def _method_cells(run: Measured, scores: dict[str, ScoreRecord]) -> tuple[TableCell, ...]:
    pooled = _pooled([(int(score.detail["consistent"]), score.n) for score in scores.values()])
    if pooled is None:
        return (TableCell(MISSING),) * len(_METHOD_HEADS)
    share = f"{pooled.scenes}/{len(run.scenes)}"
    powerless = sum(bool(score.detail["powerless_against"]) for score in scores.values())
    mean = f"{pooled.mean:.4f}" + ("" if pooled.scenes == len(run.scenes) else f" ({share})")

    def over_scenes(key: str, decimals: int) -> TableCell:
        return _mean_cell([score.detail[key] for score in scores.values()], decimals)

    return (
        TableCell(f"{pooled.value:.4f}", pooled.value, low=pooled.low, high=pooled.high),
        TableCell(f"{pooled.low:.4f}-{pooled.high:.4f}"),
        TableCell(pooled.text),
        TableCell(mean, pooled.mean, share),
        *(over_scenes(key, 3) for key in _NULLS),
        over_scenes("median_sed", 3),
        over_scenes("median_flow", 1),
        TableCell(f"{powerless}/{len(scores)}", float(powerless)),
    )


def _scenes(run: Measured, metric: str) -> Table:
    heads = (
        Head("tsed", "TSED ↑"),
        *(Head(key, title) for key, title in _NULLS.items()),
        Head("median_sed", "Median SED [px] ↓"),
        Head("median_flow", "Median flow [px]"),
        Head("warning", "Reading"),
    )
    rows = []
    for scene in run.scenes:
        for method in run.methods:
            score = _scored(run, method, metric).get(scene)
            cells = (TableCell(MISSING),) * len(heads) if score is None else _scene_cells(score)
            rows.append(Row((scene, method), cells, group_start=method == run.methods[0]))
    title = f"{run.dataset}: TSED of every scene, {TSED_MODES[metric]}"
    return Table(f"{metric}_scenes", title, ("Scene", "Method"), heads, tuple(rows), (_variant(run, metric),))


def _scene_cells(score: ScoreRecord) -> tuple[TableCell, ...]:
    detail = score.detail
    return (
        TableCell(f"{score.value:.4f}", score.value),
        *(_number(detail[key], 3) for key in _NULLS),
        _number(detail["median_sed"], 3),
        _number(detail["median_flow"], 1),
        TableCell(str(detail["warning"] or "")),
    )


def _grid(run: Measured, metric: str) -> Table:
    """Pooled share at every pair of thresholds, and which row lies nearest to the paper's numbers."""
    counts = _grid_counts(run, metric)
    rows: list[Row] = []
    values: dict[tuple[str, ...], dict[str, float]] = {}
    for width, t_error, t_matches in sorted(counts, key=lambda key: (key[0] != NATIVE, key)):
        by_method = counts[width, t_error, t_matches]
        pooled = {method: _pooled(by_method.get(method, [])) for method in run.methods}
        cells = (TableCell(MISSING) if p is None else TableCell(f"{p.value:.4f}", p.value) for p in pooled.values())
        labels = (width, f"{t_error:g}", str(t_matches))
        values[labels] = {method: p.value for method, p in pooled.items() if p is not None}
        rows.append(Row(labels, tuple(cells), group_start=not rows or rows[-1].labels[0] != width))
    heads = tuple(Head(method, f"{method} ↑") for method in run.methods)
    title = f"{run.dataset}: pooled TSED over the grid of thresholds, {TSED_MODES[metric]}"
    notes = _nearest(run, values) if metric == "tsed" else ()
    return Table(f"{metric}_grid", title, ("Width", "T_error [px]", "T_matches"), heads, tuple(rows), notes)


def _grid_counts(run: Measured, metric: str) -> dict[tuple[str, float, int], dict[str, list[tuple[int, int]]]]:
    """(width, T_error, T_matches) -> method -> (consistent, pairs) of each scene; "native" pools any width."""
    counts: dict[tuple[str, float, int], dict[str, list[tuple[int, int]]]] = {}
    for method in run.methods:
        for score in _scored(run, method, metric).values():
            native, normalised = score.detail["width"], score.detail["config"]["curve_width"]
            for row in score.detail["curve"]:
                consistent = round((row["tsed"] or 0.0) * score.n)
                here = row["t_error_width"]
                names = ([NATIVE] if here == native else []) + ([str(here)] if here == normalised else [])
                for name in names:
                    cell = counts.setdefault((name, row["t_error"], row["t_matches"]), {})
                    cell.setdefault(method, []).append((consistent, score.n))
    return counts


def _nearest(run: Measured, values: dict[tuple[str, ...], dict[str, float]]) -> tuple[str, ...]:
    """The paper does not give its thresholds: say which of our rows its numbers lie nearest to, and how clearly."""
    published = {row["method"]: float(row["tsed"]) for row in read_published(3) if row["dataset"] == run.dataset}
    distances = {
        labels: fmean(abs(by_method[method] - number) for method, number in published.items())
        for labels, by_method in values.items()
        if published and published.keys() <= by_method.keys()
    }
    if not distances:
        return ()
    least = min(distances.values())
    best = [labels for labels, distance in distances.items() if distance <= least + 1e-9]
    given = ", ".join(f"{method} {number:.4f}" for method, number in published.items())
    width, t_error, t_matches = best[0]
    ties = f" ({len(best)} rows are as near)" if len(best) > 1 else ""
    return (
        f"The paper ({given}) does not give its thresholds; nearest row: width {width}, {t_error} px, {t_matches} "
        f"matches, {least:.4f} away on average{ties}.",
    )


def _variant(run: Measured, metric: str) -> str:
    return next((f"{column.title}: {column.variant}." for column in run.columns if column.key == metric), "")


def _mean_cell(values: Sequence[Any], decimals: int) -> TableCell:
    """Mean of the scenes that have a value, marked when some have none."""
    kept = [float(value) for value in values if value is not None]
    if not kept:
        return TableCell(MISSING)
    share = f"{len(kept)}/{len(values)}"
    text = f"{fmean(kept):.{decimals}f}" + ("" if len(kept) == len(values) else f" ({share})")
    return TableCell(text, fmean(kept), share)


def _number(value: float | None, decimals: int) -> TableCell:
    return TableCell(MISSING) if value is None else TableCell(f"{value:.{decimals}f}", value)
