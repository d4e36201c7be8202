"""``bench tsed``: the whole TSED of a run, from its files: pooled, per scene, nulls, and the grid of thresholds."""

from __future__ import annotations

import argparse
import shutil

from bench.commands.outcome import Outcome

__all__ = ["tsed_command"]


def tsed_command(args: argparse.Namespace) -> Outcome:
    """Print the tables. Raises `BadInput` for a folder that is no run, or a run without TSED."""
    from bench.measured import read_runs
    from bench.tables import write_tables
    from bench.tsedtable import tsed_tables

    tables = tsed_tables(read_runs(args.runs))
    width = max(120, shutil.get_terminal_size((120, 24)).columns)
    document = {"schema_version": 1, "tables": {table.name: table.to_json() for table in tables}}
    if args.write is not None:
        document["files"] = [str(path) for path in write_tables(args.write, tables)]
    return Outcome("\n".join(table.to_text(width) for table in tables), document)
