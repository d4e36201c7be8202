"""``bench compare``: what moved between two runs, and whether anything became worse."""

from __future__ import annotations

import argparse
import shutil

from bench.commands.outcome import Outcome
from bench.compare import compare_runs, parse_thresholds
from bench.measured import read_runs

__all__ = ["compare_command"]


def compare_command(args: argparse.Namespace) -> Outcome:
    """Compare run B with run A; exit code 1 on a regression. Raises `BadInput` for runs that cannot be compared."""
    thresholds = parse_thresholds(args.threshold)
    comparison = compare_runs(read_runs([args.run_a], slim=True), read_runs([args.run_b], slim=True), thresholds)
    width = max(120, shutil.get_terminal_size((120, 24)).columns)
    table = comparison.table(args.all)
    text = table.to_markdown() if args.format == "markdown" else table.to_text(width)
    worse = comparison.regressions
    text += f"\n{len(worse)} regressions: {', '.join(worse)}\n" if worse else "\nno regression\n"
    document = {"a": str(args.run_a), "b": str(args.run_b), **comparison.to_json()}
    return Outcome(text, document, 1 if worse else 0)
