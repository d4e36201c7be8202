"""The matrix of cases and methods, for people: text and Markdown, CSV, and a picture."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bench.stability.outcome import (
    CRASH,
    DEGRADED,
    EXACT,
    OUT_OF_MEMORY,
    OUTCOMES,
    SILENT_WRONG,
    TIME_OUT,
    TYPED,
)
from bench.tableformat import Head, Row, Table, TableCell
from orca.atomic import atomic_path

__all__ = ["matrix_csv", "matrix_table", "totals", "write_matrix"]

_COLOURS = {
    EXACT: "#2e7d32",
    DEGRADED: "#a5d6a7",
    TYPED: "#90caf9",
    TIME_OUT: "#ffb74d",
    OUT_OF_MEMORY: "#ce93d8",
    CRASH: "#c62828",
    SILENT_WRONG: "#4e0d0d",
}
_CSV = (
    "case",
    "group",
    "about",
    "method",
    "outcome",
    "expected",
    "as_expected",
    "detail",
    "seconds",
    "cpu_s",
    "peak_mb",
)
_COLUMNS = 2  # the picture's blocks of cases, side by side


def matrix_table(rows: Sequence[dict[str, Any]]) -> Table:
    """One line a case, one column a method; ``*`` marks what is known from elsewhere, ``!`` what is unexpected."""
    methods = list(dict.fromkeys(row["method"] for row in rows))
    found = {(row["case"], row["method"]): row for row in rows}
    lines, last = [], ""
    for case, group in dict.fromkeys((row["case"], row["group"]) for row in rows):
        cells = tuple(_cell(found.get((case, method))) for method in methods)
        lines.append(Row((group, case), cells, group_start=group != last))
        last = group
    notes = [f"{method}: {totals(rows, method)}" for method in methods]
    notes += [
        f"! {row['case']}, {row['method']}: expected {' or '.join(row['expected'])}; {row['detail']}"
        for row in rows
        if row["as_expected"] is False
    ]
    notes += [f"* {row['case']}, {row['method']}: {row['detail']}" for row in rows if not row["measured"]]
    heads = tuple(Head(method, method) for method in methods)
    return Table("stability", "Stability", ("Group", "Case"), heads, tuple(lines), tuple(notes))


def totals(rows: Sequence[dict[str, Any]], method: str) -> str:
    """How often a method had which outcome, in words."""
    counts = Counter(row["outcome"] for row in rows if row["method"] == method and row["measured"])
    if not counts:
        return "not run here"
    told = ", ".join(f"{counts[outcome]} {outcome}" for outcome in OUTCOMES if counts[outcome])
    return f"{counts.total()} cases: {told}"


def _cell(row: dict[str, Any] | None) -> TableCell:
    if row is None:
        return TableCell("-")
    mark = "*" if not row["measured"] else "" if row["as_expected"] else " !"
    return TableCell(row["outcome"] + mark)


def matrix_csv(rows: Sequence[dict[str, Any]]) -> str:
    """One line a case and method, with everything that is known."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(_CSV)
    for row in rows:
        plain = {**row, "expected": " or ".join(row["expected"])}
        writer.writerow(["" if plain.get(key) is None else plain[key] for key in _CSV])
    return out.getvalue()


def write_matrix(rows: Sequence[dict[str, Any]], folder: Path) -> tuple[Path, ...]:
    """Write ``stability.md``, ``.csv`` and ``.png``; returns their paths."""
    markdown, table, picture = (folder / f"stability.{suffix}" for suffix in ("md", "csv", "png"))
    for path, text in ((markdown, matrix_table(rows).to_markdown()), (table, matrix_csv(rows))):
        with atomic_path(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
    _draw(rows, picture)
    return markdown, table, picture


def _draw(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """A coloured square for each case and method; a dot marks what was not as expected."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt
    from matplotlib.patches import Patch

    methods = list(dict.fromkeys(row["method"] for row in rows))
    cases = list(dict.fromkeys(row["case"] for row in rows))
    height = -(-len(cases) // _COLUMNS)
    size = (_COLUMNS * (2.0 + 0.5 * len(methods)), 1.6 + 0.17 * height)
    figure, axes = plt.subplots(1, _COLUMNS, figsize=size, squeeze=False)
    for block, axis in enumerate(axes[0]):
        shown = cases[block * height : (block + 1) * height]
        for row in rows:
            if row["case"] in shown:
                at = methods.index(row["method"]), shown.index(row["case"])
                axis.add_patch(plt.Rectangle(at, 0.94, 0.9, color=_COLOURS[row["outcome"]]))
                if row["as_expected"] is False:
                    axis.plot(at[0] + 0.5, at[1] + 0.45, "w.", markersize=4)
        axis.set(xlim=(0, len(methods)), ylim=(height, 0))
        axis.set_yticks([i + 0.45 for i in range(len(shown))], shown, fontsize=6.5)
        axis.set_xticks([i + 0.5 for i in range(len(methods))], methods, fontsize=7, rotation=35, ha="left")
        axis.tick_params(length=0, top=True, labeltop=True, bottom=False, labelbottom=False)
        axis.spines[:].set_visible(False)
    present = [outcome for outcome in OUTCOMES if any(row["outcome"] == outcome for row in rows)]
    handles = [Patch(color=_COLOURS[outcome], label=outcome) for outcome in present]
    figure.legend(handles=handles, loc="lower center", ncols=4, fontsize=7, frameon=False)
    figure.tight_layout(rect=(0, 0.05, 1, 1))
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=80)
    plt.close(figure)
