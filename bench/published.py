"""The paper's own numbers, kept as data: printed beside ours, never in one cell with them."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from importlib import resources

from bench.tableformat import Head, Row, Table, TableCell
from orca.errors import Unknown

__all__ = ["DATASET_TITLES", "METHOD_TITLES", "METRIC_TITLES", "PUBLISHED", "published_tables", "read_published"]

# Table number of the paper -> file name in reports/published.
PUBLISHED = {1: "table1_datasets.csv", 2: "table2_realmdreamer_scenes.csv", 3: "table3_tsed.csv"}

# The paper's headings and names.
METRIC_TITLES = {
    "musiq": "MUSIQ",
    "clipiqa": "CLIP-IQA",
    "noise_free": "NF",
    "edge": "Edge",
    "structure": "Structure",
    "detail": "Detail",
    "quality": "Quality",
    "tsed": "TSED",
}
METHOD_TITLES = {"vistadream": "VistaDream", "orca": "Ours"}
DATASET_TITLES = {"div2k": "DIV2K", "realmdreamer": "RealmDreamer"}


def read_published(table: int) -> list[dict[str, str]]:
    """Rows of one of the paper's tables, every number as the text that the paper prints.

    Raises `Unknown` for a table that the paper does not have.
    """
    if table not in PUBLISHED:
        raise Unknown(f"table {table} of the paper", ", ".join(map(str, PUBLISHED)), "choose one of them")
    text = resources.files("reports").joinpath("published", PUBLISHED[table]).read_text(encoding="utf-8")
    return list(csv.DictReader(io.StringIO(text)))


def published_tables() -> tuple[Table, Table, Table]:
    """The paper's Tables 1 (data sets), 2 (RealmDreamer scenes) and 3 (TSED), in its layout, best in bold."""
    first = _grouped(
        "published_datasets",
        "Paper, Table 1: quantitative comparison with VistaDream on DIV2K and RealmDreamer (published)",
        read_published(1),
        "dataset",
        lambda name: DATASET_TITLES[name],
    )
    second = _grouped(
        "published_realmdreamer_scenes",
        "Paper, Table 2: per-scene comparison with VistaDream on the 11 RealmDreamer scenes (published)",
        read_published(2),
        "scene",
        lambda name: name,
    )
    return first, second, _tsed_table()


def _grouped(name: str, title: str, rows: list[dict[str, str]], group: str, shown: Callable[[str], str]) -> Table:
    keys = [key for key in rows[0] if key in METRIC_TITLES]
    out, last = [], ""
    for row in rows:
        rivals = [other for other in rows if other[group] == row[group] and other is not row]
        cells = tuple(_cell(row[key], [rival[key] for rival in rivals]) for key in keys)
        out.append(Row((shown(row[group]), METHOD_TITLES[row["method"]]), cells, group_start=row[group] != last))
        last = row[group]
    heads = tuple(Head(key, f"{METRIC_TITLES[key]} ↑") for key in keys)
    return Table(name, title, (group.capitalize(), "Method"), heads, tuple(out))


def _tsed_table() -> Table:
    rows = read_published(3)
    found = {(row["dataset"], row["method"]): row["tsed"] for row in rows}
    methods = list(dict.fromkeys(row["method"] for row in rows))
    lines = []
    for dataset in dict.fromkeys(row["dataset"] for row in rows):
        values = [found[dataset, method] for method in methods]
        cells = tuple(_cell(value, values[:i] + values[i + 1 :]) for i, value in enumerate(values))
        lines.append(Row((DATASET_TITLES[dataset],), cells))
    heads = tuple(Head(method, METHOD_TITLES[method]) for method in methods)
    title = "Paper, Table 3: geometric consistency, TSED ↑, on DIV2K and RealmDreamer (published)"
    return Table("published_tsed", title, ("Dataset",), heads, tuple(lines))


def _cell(text: str, rivals: list[str]) -> TableCell:
    """All of the paper's metrics are better when higher; a tie is nobody's win."""
    value = float(text)
    return TableCell(text, value, bold=all(value > float(rival) for rival in rivals))
