"""The tables of a run, made from its files alone: one row a method, or one row a scene and method."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from bench.latex import latex_table
from bench.measured import COSTS, FAIL, MISSING, Column, Measured, Value
from bench.stats import bootstrap_interval, mean_of_present
from bench.store import write_atomic
from bench.tableformat import Head, Row, Table, TableCell

__all__ = ["dataset_table", "scene_table", "write_tables"]


def dataset_table(run: Measured, columns: Sequence[Column] | None = None, intervals: bool = False) -> Table:
    """Rows are methods, columns metrics and costs; a cell is the mean over scenes.

    A mean that misses scenes says so ("23.04 (4/5)"). Bold marks the strictly best of a column, compared as printed,
    and only where all methods were averaged over the same scenes.

    Args:
        run: what was measured.
        columns: these and no others; all metrics and costs when left out.
        intervals: print the 95 % bootstrap interval over scenes behind each mean.
    """
    notes = _Footnotes()
    counted, columns = columns is None, (*run.columns, *COSTS) if columns is None else tuple(columns)
    grid = {m: [[run.value(m, scene, column.key) for scene in run.scenes] for column in columns] for m in run.methods}
    cells = {m: [_mean_cell(c, values, notes) for c, values in zip(columns, grid[m])] for m in run.methods}
    for i, column in enumerate(columns):
        covered = {
            tuple(v.number is not None for v in grid[m][i]) for m in run.methods if cells[m][i].value is not None
        }
        if len(covered) == 1:
            _mark_best(column, [cells[m] for m in run.methods], i)
    if intervals:
        cells = {m: [_with_interval(c, cell) for c, cell in zip(columns, line)] for m, line in cells.items()}
    failed = {m: (_failed_cell(run, m),) if counted else () for m in run.methods}
    rows = [Row((method,), (*failed[method], *cells[method])) for method in run.methods]
    heads = (*((Head("failed", "Failed"),) if counted else ()), *_heads(columns))
    title = f"{run.dataset}: mean over {len(run.scenes)} scene{'s' if len(run.scenes) != 1 else ''}"
    return Table("dataset", title, ("Method",), heads, tuple(rows), (*_caption(run, columns), *notes.lines()))


def scene_table(run: Measured, columns: Sequence[Column] | None = None) -> Table:
    """Rows are (scene, method) in the layout of the paper's Table 2; bold is the strictly best of a scene's column."""
    notes = _Footnotes()
    columns = (*run.columns, *COSTS) if columns is None else tuple(columns)
    rows = []
    for scene in run.scenes:
        lines = [[_scene_cell(c, run.value(m, scene, c.key), notes) for c in columns] for m in run.methods]
        for i, column in enumerate(columns):
            _mark_best(column, lines, i)
        for method, line in zip(run.methods, lines, strict=True):
            rows.append(Row((scene, method), tuple(line), group_start=method == run.methods[0]))
    title = f"{run.dataset}: every scene"
    return Table(
        "scenes", title, ("Scene", "Method"), _heads(columns), tuple(rows), (*_caption(run, columns), *notes.lines())
    )


def write_tables(folder: Path, tables: Iterable[Table]) -> list[Path]:
    """Write each table as Markdown, LaTeX (to be included), CSV and JSON into ``folder``; return the paths."""
    written = []
    for table in tables:
        plain = json.dumps(table.to_json(), indent=1, ensure_ascii=False) + "\n"
        forms = {".md": table.to_markdown(), ".tex": latex_table(table), ".csv": table.to_csv(), ".json": plain}
        for suffix, text in forms.items():
            written.append(folder / f"{table.name}{suffix}")
            write_atomic(written[-1], text.encode())
    return written


class _Footnotes:
    """Reasons, numbered in order of appearance."""

    def __init__(self) -> None:
        self._numbers: dict[str, int] = {}

    def mark(self, reasons: Iterable[str]) -> str:
        """ " [1]" or " [1,3]" for these reasons; nothing for none."""
        found = [self._numbers.setdefault(reason, len(self._numbers) + 1) for reason in dict.fromkeys(reasons)]
        return f" [{','.join(map(str, found))}]" if found else ""

    def lines(self) -> list[str]:
        """One line a reason."""
        return [f"[{number}] {reason}" for reason, number in self._numbers.items()]


def _heads(columns: Sequence[Column]) -> tuple[Head, ...]:
    arrows = {True: " ↑", False: " ↓", None: ""}
    return tuple(Head(column.key, column.title + arrows[column.higher_is_better]) for column in columns)


def _mean_cell(column: Column, values: Sequence[Value], notes: _Footnotes) -> TableCell:
    mean = mean_of_present([value.number for value in values])
    marks = notes.mark(value.reason for value in values if value.reason)
    scenes = f"{mean.present}/{mean.total}"
    if mean.value is None:
        words = [value.word for value in values]
        word = next((w for w in (FAIL, "n/a") if w in words), MISSING)
        return TableCell(word + marks, scenes=scenes)
    text = f"{mean.value:.{column.decimals}f}" + ("" if mean.complete else f" ({scenes}){marks}")
    present = [value.number for value in values if value.number is not None]
    low, high = bootstrap_interval(present) if len(present) > 1 else (None, None)
    return TableCell(text, mean.value, scenes, low, high)


def _with_interval(column: Column, cell: TableCell) -> TableCell:
    if cell.low is None or cell.high is None:
        return cell
    digits = column.decimals
    return replace(cell, text=f"{cell.text} [{cell.low:.{digits}f}, {cell.high:.{digits}f}]")


def _scene_cell(column: Column, value: Value, notes: _Footnotes) -> TableCell:
    if value.number is None:
        return TableCell(value.word + notes.mark([value.reason] if value.reason else []))
    return TableCell(f"{value.number:.{column.decimals}f}", value.number)


def _failed_cell(run: Measured, method: str) -> TableCell:
    failed = run.failed_scenes(method)
    return TableCell(f"{failed}/{len(run.scenes)}", float(failed))


def _mark_best(column: Column, lines: Sequence[list[TableCell]], i: int) -> None:
    """Make the strictly best cell of column ``i`` bold, in place; equal as printed is a tie and nobody's win."""
    if column.higher_is_better is None:
        return
    sign = 1 if column.higher_is_better else -1
    scored = [(sign * round(value, column.decimals), line) for line in lines if (value := line[i].value) is not None]
    best = max((score for score, _ in scored), default=0.0)
    winners = [line for score, line in scored if score == best]
    if len(scored) > 1 and len(winners) == 1:
        winners[0][i] = replace(winners[0][i], bold=True)


def _caption(run: Measured, columns: Sequence[Column]) -> list[str]:
    lines = [*run.caption]
    if any(column in COSTS for column in columns):
        lines.append(
            "s/scene: all phases that the method timed, rendering of the evaluated frames included; "
            "scene loading and metrics not. ms/frame: rendering of one frame."
        )
    lines.append(
        "x/y: mean over the x of y scenes that have a value. -: not run. Bold: strictly best as printed; "
        "whether a difference holds over the scenes stands in the table of pairs."
    )
    return lines
