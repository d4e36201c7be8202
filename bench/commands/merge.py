"""``bench merge``: parts of a run in one folder."""

from __future__ import annotations

import argparse

from bench.commands.outcome import Outcome
from bench.merge import merge_runs

__all__ = ["merge_command"]


def merge_command(args: argparse.Namespace) -> Outcome:
    """Merge the runs that the command line names. Raises `BadInput` where they contradict each other."""
    merged = merge_runs(args.out, args.runs)
    text = (
        f"{merged.results} results of {len(merged.runs)} runs in {args.out}"
        f"{f', {merged.several} of them in more than one' if merged.several else ''}\n"
        f"its tables: python -m bench table {args.out}"
    )
    document = {
        "schema_version": 1,
        "out": str(args.out),
        "runs": [str(path) for path in merged.runs],
        "results": merged.results,
        "several": merged.several,
    }
    return Outcome(text, document)
