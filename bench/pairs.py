"""Does A beat B? Every metric of two methods on the same scenes: difference, interval, Wilcoxon test, verdict."""

from __future__ import annotations

from collections.abc import Sequence

from bench.measured import Column, Measured
from bench.stats import PairedTest, paired_test
from bench.tableformat import Head, Row, Table, TableCell
from orca.errors import Unknown

__all__ = ["compared_rows", "number_cells", "pairs_table", "verdict"]

_HEADS = (
    Head("n", "Scenes"),
    Head("mean", "Mean"),
    Head("other", "Other"),
    Head("difference", "Other - mean"),
    Head("low", "95 % low"),
    Head("high", "95 % high"),
    Head("p", "Wilcoxon p"),
    Head("verdict", "Verdict"),
)


def pairs_table(run: Measured, against: str | None = None) -> Table:
    """The first method (or ``against``) beside every other: one row a metric and other method.

    Only scenes on which both have a value count. A win is claimed where the 95 % bootstrap interval of the mean
    difference leaves out zero and a paired two-sided Wilcoxon test gives p < 0.05; the tests are not corrected for
    their number.

    Raises:
        Unknown: a method that the run does not have.
    """
    if against is not None and against not in run.methods:
        raise Unknown(f"unknown method '{against}'", ", ".join(run.methods), "choose one of them")
    base = against or next(iter(run.methods), "")
    rows: list[Row] = []
    for column in run.columns:
        lines = compared_rows(run, column, base, [m for m in run.methods if m != base])
        rows += [Row((column.title, name), cells, group_start=i == 0) for i, (name, cells) in enumerate(lines)]
    notes = (
        "Scenes on which both have a value; intervals: percentile bootstrap of the mean difference, 2000 resamples.",
        "A win needs an interval without zero and p < 0.05 (paired, two-sided, not corrected for many tests), "
        "hence six scenes at least.",
    )
    return Table("pairs", f"{run.dataset}: {base} against the others", ("Metric", "Other"), _HEADS, tuple(rows), notes)


def compared_rows(
    run: Measured, column: Column, base: str, others: Sequence[str]
) -> list[tuple[str, tuple[TableCell, ...]]]:
    """Name and cells of every other method that shares a scene with ``base`` in this column."""
    rows = []
    for other in others:
        values = [(run.value(base, s, column.key).number, run.value(other, s, column.key).number) for s in run.scenes]
        both = [(a, b) for a, b in values if a is not None and b is not None]
        if both:
            test = paired_test([a for a, _ in both], [b for _, b in both])
            rows.append((other, (*number_cells(column, test), TableCell(verdict(column, test, base, other)))))
    return rows


def number_cells(column: Column, test: PairedTest) -> tuple[TableCell, ...]:
    """n, both means, difference, interval and p of a test, as cells."""

    def number(value: float | None, sign: str = "") -> TableCell:
        return TableCell("-") if value is None else TableCell(f"{value:{sign}.{column.decimals}f}", value)

    return (
        TableCell(str(test.n), float(test.n)),
        number(test.mean_a),
        number(test.mean_b),
        *(number(value, "+") for value in (test.difference, test.low, test.high)),
        TableCell("-") if test.p is None else TableCell(f"{test.p:.4f}", test.p),
    )


def verdict(column: Column, test: PairedTest, base: str, other: str) -> str:
    """Who is better, or that nothing is claimed."""
    if not test.significant or column.higher_is_better is None:
        return "no claim"
    return f"{other if (test.difference > 0) == column.higher_is_better else base} better"
