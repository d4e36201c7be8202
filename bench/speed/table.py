"""Rows, ratios and exponents as people read them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from bench.speed.measure import Ratio, SpeedRow
from bench.speed.scaling import Exponent
from bench.tableformat import Head, Row, Table, TableCell

__all__ = ["exponent_lines", "machine_line", "ratio_lines", "speed_table"]

_LABELS = ("Case", "Mode", "Anchors", "Width", "Threads", "Backend")
_HEADS = (
    Head("wall_ms", "Wall [ms]"),
    Head("spread", "Quartiles"),
    Head("cpu_ms", "CPU [ms]"),
    Head("peak_mb", "Peak [MB]"),
    Head("psnr", "PSNR"),
    Head("hits_per_ray", "Hits/ray"),
)
NOTES = (
    "Wall and CPU: medians over the rounds; CPU is that of all threads. Rows of one setting were timed in turns.",
    "Peak: largest resident set of a fresh process that runs the case once, libraries included; - is not measured.",
    "PSNR: of the input view in dB, where the size is the one that the scene was fitted at.",
    "Fit and stage 3 have no second implementation to be timed against.",
)


def speed_table(rows: Sequence[SpeedRow]) -> Table:
    """All rows, in the order in which they were measured."""
    return Table("speed", "Speed", _LABELS, _HEADS, tuple(_line(row, i, rows) for i, row in enumerate(rows)), NOTES)


def _line(row: SpeedRow, index: int, rows: Sequence[SpeedRow]) -> Row:
    labels = (row.case, row.mode, _thousands(row.anchors), str(row.width), str(row.threads), row.backend)
    cells = (
        _cell(row.wall_ms, ".1f"),
        TableCell(f"{row.wall_ms_q25:.1f}-{row.wall_ms_q75:.1f}", row.wall_ms_q75 - row.wall_ms_q25),
        _cell(row.cpu_ms, ".1f"),
        _cell(row.peak_mb, ".0f"),
        _cell(row.psnr, ".2f"),
        _cell(row.facts.get("hits_per_ray"), ".2f"),
    )
    return Row(labels, cells, group_start=index == 0 or rows[index - 1].case != row.case)


def _cell(value: float | None, form: str) -> TableCell:
    return TableCell("-") if value is None else TableCell(format(value, form), float(value))


def _thousands(anchors: int) -> str:
    return f"{anchors / 1024:.0f}k" if anchors % 1024 == 0 and anchors >= 10_240 else str(anchors)


def ratio_lines(ratios: Sequence[Ratio]) -> list[str]:
    """One line a pair of backends."""
    lines = []
    for r in ratios:
        line = (
            f"{r.case} {r.mode}, {_thousands(r.anchors)} anchors, {r.width} px, {r.threads} thread(s): fast is "
            f"{r.wall:.1f}x the reference ({r.wall_low:.1f}-{r.wall_high:.1f}; CPU {r.cpu:.1f}x)"
        )
        lines.append(line + (f"; frames differ by {r.largest_difference:.1e} at most" if r.largest_difference else ""))
    return lines


def exponent_lines(exponents: Sequence[Exponent]) -> list[str]:
    """One line an exponent."""
    return [
        f"{e.case} {e.mode} {e.backend}, {e.threads} thread(s), "
        + (f"{_thousands(e.fixed)} anchors" if e.along == "pixels" else f"{e.fixed} px")
        + f": time grows with {e.along}^{e.value:.2f} ({e.sizes[0]} to {e.sizes[-1]})"
        for e in exponents
    ]


def machine_line(machine: dict[str, Any]) -> str:
    """The machine in a line."""
    load = machine["load"]
    busy = f", load {load['before']:.1f} before and {load['after']:.1f} after" if load else ""
    return f"{machine['cpu']}, {machine['cores']} cores, {machine['memory_gib']} GiB{busy}"
