"""``bench table``: tables from files, of runs or of the paper or of both; nothing is computed but means."""

from __future__ import annotations

import argparse
import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from bench.commands.names import chosen
from bench.commands.outcome import Outcome
from bench.latex import latex_document
from bench.tableformat import Table
from orca.errors import BadInput

__all__ = ["table_command"]


def table_command(args: argparse.Namespace) -> Outcome:
    """Print the tables of one or more runs, or the paper's. Raises `BadInput` for neither, `Unknown` for a name."""
    if not args.runs and not args.published:
        raise BadInput(
            "no run to print",
            "python -m bench table RUN [RUN ...], or python -m bench table --published",
            "name the folder of a run, such as runs/photos-draft",
        )
    tables = _tables(args)
    if args.only is not None:
        tables = [table for table in tables if table.name in chosen("table", [args.only], [t.name for t in tables], ())]
    document = {"schema_version": 1, "tables": {table.name: table.to_json() for table in tables}}
    if args.write is not None:
        from bench.tables import write_tables

        document["files"] = [str(path) for path in write_tables(args.write, tables)]
    return Outcome(_text(args.format, tables, document), document)


def _text(form: str, tables: Sequence[Table], document: dict[str, object]) -> str:
    if form == "latex":
        return latex_document(tables)
    if form == "json":
        return json.dumps(document, indent=1, ensure_ascii=False)
    width = max(120, shutil.get_terminal_size((120, 24)).columns)
    texts = {"text": lambda t: t.to_text(width), "markdown": Table.to_markdown, "csv": Table.to_csv}
    return "\n".join(texts[form](table) for table in tables)


def _tables(args: argparse.Namespace) -> list[Table]:
    if not args.runs:
        from bench.published import published_tables

        return list(published_tables())
    return _paper(args) if args.paper or args.published else _measured(args)


def _paper(args: argparse.Namespace) -> list[Table]:
    """The paper's layout: runs over several data sets share its first and its third table."""
    from bench.measured import read_runs
    from bench.papertables import paper_tables
    from bench.store import RunStore

    by_dataset: dict[str, list[Path]] = {}
    for root in args.runs:
        run = RunStore(root).load_run()
        by_dataset.setdefault("" if run is None else str(run["identity"]["dataset"]), []).append(root)
    return list(paper_tables([read_runs(roots, slim=True) for roots in by_dataset.values()], args.published))


def _measured(args: argparse.Namespace) -> list[Table]:
    from bench.measured import COSTS, read_runs
    from bench.pairs import pairs_table
    from bench.tables import dataset_table, scene_table

    run = read_runs(args.runs, slim=True)
    known = {column.key: column for column in (*run.columns, *COSTS)}
    columns = None if args.columns is None else [known[key] for key in chosen("column", args.columns, known, ())]
    tables = [scene_table(run, columns), dataset_table(run, columns, args.intervals)]
    if args.exclude_failed_anywhere:
        from bench.exclusion import without_failed_anywhere

        kept = dataset_table(without_failed_anywhere(run), columns, args.intervals)
        tables.append(replace(kept, name="dataset_excluded", title=f"{kept.title}, the paper's rule"))
    if len(run.methods) > 1 and (args.against is not None or args.only == "pairs" or args.format == "json"):
        tables.append(pairs_table(run, args.against))
    return tables
