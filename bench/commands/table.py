"""``bench table``: tables from files, of a run or of the paper; nothing is computed."""

from __future__ import annotations

import argparse
import shutil
from collections.abc import Sequence

from bench.commands.outcome import Outcome
from bench.tableformat import Table
from orca.errors import BadInput

__all__ = ["table_command"]


def table_command(args: argparse.Namespace) -> Outcome:
    """Print the tables of one or more runs, or the paper's. Raises `BadInput` unless it is one or the other."""
    if args.published == bool(args.runs):
        raise BadInput(
            "a run and --published" if args.published else "no run to print",
            "python -m bench table RUN [RUN ...], or python -m bench table --published",
            "name the folder of a run, such as runs/photos-draft",
        )
    tables = _published() if args.published else _measured(args)
    width = max(120, shutil.get_terminal_size((120, 24)).columns)
    texts = {"text": lambda t: t.to_text(width), "markdown": Table.to_markdown, "csv": Table.to_csv}
    text = "\n".join(texts[args.format](table) for table in tables)
    return Outcome(text, {"schema_version": 1, "tables": {table.name: table.to_json() for table in tables}})


def _published() -> Sequence[Table]:
    from bench.published import published_tables

    return published_tables()


def _measured(args: argparse.Namespace) -> Sequence[Table]:
    from bench.measured import read_runs
    from bench.tables import dataset_table, scene_table

    run = read_runs(args.runs)
    return scene_table(run), dataset_table(run)
