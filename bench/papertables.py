"""Measured runs in the rows and columns of the paper's Tables 1-3, its published numbers beside them in rows apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from bench.measured import Column, Measured
from bench.published import DATASET_TITLES, METHOD_TITLES, METRIC_TITLES, read_published
from bench.tableformat import Head, Row, Table, TableCell
from bench.tables import dataset_table, scene_table

__all__ = ["PAPER_METRICS", "paper_tables"]

# Metric id here -> column of the published tables, in the paper's order.
PAPER_METRICS = {
    "musiq": "musiq",
    "clipiqa": "clipiqa",
    "llava_noise_free": "noise_free",
    "llava_edge": "edge",
    "llava_structure": "structure",
    "llava_detail": "detail",
    "llava_quality": "quality",
}
_BESIDE = "Published rows are the paper's own numbers, not measured here, and take no part in the bold."


def paper_tables(runs: Sequence[Measured], published: bool = False) -> tuple[Table, ...]:
    """The paper's three tables from runs, one each data set: data sets, scenes of each data set, TSED.

    Args:
        runs: one for each data set.
        published: add the paper's numbers as rows (Tables 1 and 2) and columns (Table 3) of their own.
    """
    scenes = tuple(_scenes(run, published) for run in runs)
    return (_datasets(runs, published), *scenes, _tsed(runs, published))


def _columns(run: Measured, decimals: int | None) -> tuple[Column, ...]:
    """The paper's columns under its headings, measured or not; ``decimals`` for all, None: 4 for scores, 2 for shares.

    The paper prints shares of 50 frames with two digits and everything else with four.
    """
    known = {column.key: column for column in run.columns}
    columns = []
    for key, name in PAPER_METRICS.items():
        digits = decimals or (2 if key.startswith("llava") else 4)
        column = known.get(key, Column(key, key, digits, True))
        columns.append(replace(column, title=METRIC_TITLES[name], decimals=digits))
    return tuple(columns)


def _datasets(runs: Sequence[Measured], published: bool) -> Table:
    rows: list[Row] = []
    notes: list[str] = []
    heads: tuple[Head, ...] = ()
    for run in runs:
        table = dataset_table(run, _columns(run, 4))
        heads, shown = table.heads, DATASET_TITLES.get(run.dataset, run.dataset)
        mine = [Row((shown, row.labels[0]), row.cells, i == 0) for i, row in enumerate(table.rows)]
        rows += mine + (_published_rows(1, "dataset", run.dataset, shown) if published else [])
        notes += [f"{shown}: {note}" if len(runs) > 1 else note for note in table.notes]
    title = f"Mean over the scenes of {', '.join(DATASET_TITLES.get(run.dataset, run.dataset) for run in runs)}"
    return Table("paper_datasets", title, ("Dataset", "Method"), heads, tuple(rows), _noted(notes, published))


def _scenes(run: Measured, published: bool) -> Table:
    table = scene_table(run, _columns(run, None))
    rows: list[Row] = []
    known = {row["scene"] for row in read_published(2)} if run.dataset == "realmdreamer" and published else set()
    for i, row in enumerate(table.rows):
        rows.append(row)
        last = i + 1 == len(table.rows) or table.rows[i + 1].group_start
        if last and row.labels[0] in known:
            rows += _published_rows(2, "scene", row.labels[0], row.labels[0])
    title = f"Scenes of {DATASET_TITLES.get(run.dataset, run.dataset)}"
    name = f"paper_{run.dataset}_scenes"
    return Table(name, title, table.label_heads, table.heads, tuple(rows), _noted(table.notes, bool(known)))


def _tsed(runs: Sequence[Measured], published: bool) -> Table:
    """Data sets as rows, methods as columns."""
    methods = tuple(dict.fromkeys(method for run in runs for method in run.methods))
    paper = {(row["dataset"], row["method"]): row["tsed"] for row in read_published(3)} if published else {}
    names = tuple(dict.fromkeys(method for _, method in paper))
    rows: list[Row] = []
    notes: list[str] = []
    for run in runs:
        column = next((c for c in run.columns if c.key == "tsed"), Column("tsed", "TSED", 4, True))
        table = dataset_table(run, (replace(column, decimals=4),))
        cells = {row.labels[0]: row.cells[0] for row in table.rows}
        known = [_plain(paper[run.dataset, n]) if (run.dataset, n) in paper else TableCell("-") for n in names]
        measured = [cells.get(method, TableCell("-")) for method in methods]
        rows.append(Row((DATASET_TITLES.get(run.dataset, run.dataset),), (*measured, *known)))
        notes += table.notes
    heads = (
        *(Head(m, m) for m in methods),
        *(Head(f"published_{n}", f"{METHOD_TITLES[n]} (published)") for n in names),
    )
    title = "Geometric consistency, TSED ↑"
    return Table("paper_tsed", title, ("Dataset",), heads, tuple(rows), _noted(notes, published))


def _published_rows(number: int, group: str, name: str, shown: str) -> list[Row]:
    found = [row for row in read_published(number) if row[group] == name]
    return [
        Row(
            (shown, f"{METHOD_TITLES[row['method']]} (published)"),
            tuple(_plain(row[c]) for c in PAPER_METRICS.values()),
        )
        for row in found
    ]


def _plain(text: str) -> TableCell:
    return TableCell(text, float(text))


def _noted(notes: Sequence[str], published: bool) -> tuple[str, ...]:
    return (*dict.fromkeys(notes), *((_BESIDE,) if published else ()))
