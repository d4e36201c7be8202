"""``bench chart``: speed against accuracy, from the files of runs."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from bench.commands.names import chosen
from bench.commands.outcome import Outcome
from orca.errors import BadInput

__all__ = ["chart_command", "draw_runs"]


def chart_command(args: argparse.Namespace) -> Outcome:
    """Draw the chart of one or more runs. Raises `BadInput` for no run or nothing to draw, `Unknown` for a name."""
    return draw_runs(args.runs, args.out or args.runs[0] / "chart", args.metrics, args.costs)


def draw_runs(
    roots: Sequence[Path], out: Path, metrics: Sequence[str] | None = None, costs: Sequence[str] | None = None
) -> Outcome:
    """Read the runs, write the chart into ``out``, say its fronts.

    Args:
        roots: folders of runs over one data set.
        out: folder of the pictures.
        metrics: names as the command line gives them; all when left out.
        costs: of `bench.chart.CHART_COSTS`; all when left out.
    """
    from bench.chart import CHART_COSTS, build_chart, chart_words, write_charts
    from bench.chart.files import chart_document
    from bench.measured import read_runs

    run = read_runs(roots)
    columns = {column.key: column for column in run.columns}
    by_key = {column.key: column for column in CHART_COSTS}
    chart = build_chart(
        run,
        [by_key[key] for key in chosen("cost", costs, by_key, by_key)],
        [columns[key] for key in chosen("metric", metrics, columns, columns)],
    )
    if not chart.panels:
        raise BadInput(
            f"nothing to draw: {'; '.join(chart.notes)}",
            "a score that two methods have, and one of them with a time",
            "run more methods: python -m bench sweep",
        )
    written = write_charts(chart, out)
    lines = [*chart_words(chart), *(f"wrote {path}" for path in written)]
    document = {"schema_version": 1, **chart_document(chart), "files": [str(path) for path in written]}
    return Outcome("\n".join(lines), document)
