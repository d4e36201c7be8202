"""A table as data, and the ways it is written: aligned text, Markdown, CSV, JSON (LaTeX: `bench.latex`)."""

from __future__ import annotations

import csv
import io
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

__all__ = ["Head", "Row", "Table", "TableCell"]

_GAP = "  "


@dataclass(frozen=True)
class Head:
    """A value column: its machine name and its heading for people."""

    key: str
    title: str


@dataclass(frozen=True)
class TableCell:
    """One cell.

    Attributes:
        text: what people read ("23.04 (4/5) [1]", "n/a [2]", "fail [3]", "-").
        value: what machines read; None where there is no number.
        scenes: "present/total" where the value is a mean.
        low, high: 95 % bootstrap interval over the scenes, where the value is a mean of two or more.
        bold: strictly best of its column.
    """

    text: str
    value: float | None = None
    scenes: str = ""
    low: float | None = None
    high: float | None = None
    bold: bool = False


@dataclass(frozen=True)
class Row:
    """Labels on the left, cells on the right; ``group_start`` marks the first row of a group of rows."""

    labels: tuple[str, ...]
    cells: tuple[TableCell, ...]
    group_start: bool = False


@dataclass(frozen=True)
class Table:
    """A whole table.

    Attributes:
        name: file name without suffix.
        title: one line above.
        label_heads: headings of the label columns.
        heads: the value columns.
        rows: the lines.
        notes: caption and footnotes, below.
    """

    name: str
    title: str
    label_heads: tuple[str, ...]
    heads: tuple[Head, ...]
    rows: tuple[Row, ...]
    notes: tuple[str, ...] = ()

    def to_text(self, width: int = 120) -> str:
        """Aligned plain text; columns that do not fit in ``width`` go into further blocks with the labels repeated."""
        labels = _aligned([self.label_heads, *(_shown_labels(row) for row in self.rows)], left=True)
        blocks = []
        for block in self._blocks(width - len(labels[0])):
            values = _aligned(
                [[self.heads[i].title for i in block], *([r.cells[i].text for i in block] for r in self.rows)]
            )
            lines = [(label + _GAP + value).rstrip() for label, value in zip(labels, values, strict=True)]
            rule = "-" * max(map(len, lines))
            spaced = [
                "\n" + line if row.group_start and i else line
                for i, (row, line) in enumerate(zip(self.rows, lines[1:]))
            ]
            blocks.append("\n".join([lines[0], rule, *spaced]))
        notes = "\n".join(textwrap.fill(note, width, subsequent_indent="    ") for note in self.notes)
        return "\n\n".join([self.title, *blocks, *([notes] if notes else [])]) + "\n"

    def to_markdown(self) -> str:
        """A GitHub table, bold where strictly best, notes as a list below."""
        heads = [*self.label_heads, *(head.title for head in self.heads)]
        rule = ["---"] * len(self.label_heads) + ["---:"] * len(self.heads)
        rows = [[*_shown_labels(row), *(f"**{c.text}**" if c.bold else c.text for c in row.cells)] for row in self.rows]
        body = "\n".join(
            "| " + " | ".join(text.replace("|", "\\|") for text in line) + " |" for line in [heads, rule, *rows]
        )
        notes = "\n".join(f"- {note}" for note in self.notes)
        return f"### {self.title}\n\n{body}\n" + (f"\n{notes}\n" if notes else "")

    def to_csv(self) -> str:
        """Raw numbers, empty where there is none.

        Means get a column ``<key>_scenes`` with present/total, and those of two scenes or more ``<key>_low`` and
        ``<key>_high``, their 95 % interval.
        """
        extras = [self._extras(i) for i in range(len(self.heads))]
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        names = [[head.key, *(f"{head.key}_{extra}" for extra in more)] for head, more in zip(self.heads, extras)]
        writer.writerow([*(head.lower() for head in self.label_heads), *(name for some in names for name in some)])
        for row in self.rows:
            line: list[str] = list(row.labels)
            for cell, more in zip(row.cells, extras):
                line += [_csv_number(cell.value), *(_csv_extra(cell, extra) for extra in more)]
            writer.writerow(line)
        return out.getvalue()

    def _extras(self, i: int) -> list[str]:
        """Which further columns a value column has in the CSV."""
        cells = [row.cells[i] for row in self.rows]
        counted = ["scenes"] if any(cell.scenes for cell in cells) else []
        return counted + (["low", "high"] if any(cell.low is not None for cell in cells) else [])

    def to_json(self) -> dict[str, Any]:
        """The table as plain data."""
        rows = []
        for row in self.rows:
            labels = {head.lower(): label for head, label in zip(self.label_heads, row.labels, strict=True)}
            rows.append(labels | {"cells": {h.key: _cell_json(c) for h, c in zip(self.heads, row.cells, strict=True)}})
        return {"name": self.name, "title": self.title, "rows": rows, "notes": list(self.notes)}

    def _blocks(self, room: int) -> list[list[int]]:
        """Indices of the value columns, cut where the next one would not fit; at least one a block."""
        blocks: list[list[int]] = [[]]
        used = 0
        for i, head in enumerate(self.heads):
            need = len(_GAP) + max(len(head.title), *(len(row.cells[i].text) for row in self.rows), 0)
            if blocks[-1] and used + need > room:
                blocks.append([])
                used = 0
            blocks[-1].append(i)
            used += need
        return blocks


def _csv_number(value: float | None) -> str:
    return "" if value is None else f"{value:.6f}".rstrip("0").rstrip(".")


def _csv_extra(cell: TableCell, extra: str) -> str:
    return cell.scenes if extra == "scenes" else _csv_number(getattr(cell, extra))


def _cell_json(cell: TableCell) -> dict[str, Any]:
    plain: dict[str, Any] = {"value": cell.value, "text": cell.text, "bold": cell.bold}
    if cell.scenes:
        plain["scenes"] = cell.scenes
    if cell.low is not None:
        plain["interval95"] = [cell.low, cell.high]
    return plain


def _shown_labels(row: Row) -> list[str]:
    """A group's name stands on its first row only, as the paper's multirow has it."""
    return list(row.labels) if row.group_start or len(row.labels) == 1 else ["", *row.labels[1:]]


def _aligned(rows: Sequence[Sequence[str]], left: bool = False) -> list[str]:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return [
        _GAP.join(text.ljust(w) if left else text.rjust(w) for text, w in zip(row, widths, strict=True)) for row in rows
    ]
