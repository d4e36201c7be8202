"""``bench stability``: the matrix of cases and methods, or the curves of quality against disturbance."""

from __future__ import annotations

import argparse
from pathlib import Path

from bench.adapters import METHODS
from bench.commands.names import chosen
from bench.commands.outcome import Outcome
from bench.host import host_facts
from bench.progress import BarReporter
from bench.stability.catalogue import choose_cases
from bench.stability.rows import StabilityRows
from bench.stability.run import StabilityRequest, run_stability
from bench.stability.table import matrix_table, write_matrix
from bench.stability.worker import Limits
from orca.config import get_preset
from orca.errors import BadInput

__all__ = ["stability_command"]

_METHODS = ("orca", "warp", "warp-telea")


def stability_command(args: argparse.Namespace) -> Outcome:
    """Run what is missing, print the matrix; exit code 1 when an outcome is not among those expected.

    Raises:
        Unknown: no such method, case, preset or curve.
        BadInput: a limit that is none.
        Unavailable: a case was asked for by name and its data are not here.
    """
    methods = chosen("method", args.methods, METHODS, _METHODS)
    get_preset(args.preset)
    limits = _limits(args)
    if args.curves is not None:
        from bench.commands.curves import curves_outcome

        return curves_outcome(args, methods, limits)
    cases, left_out = choose_cases(args.cases)
    out = args.out or Path("runs") / "stability"
    request = StabilityRequest(cases, methods, out, limits, args.preset, args.retry_unexpected)
    rows = run_stability(request, BarReporter())
    return _outcome(rows, [case.name for case in cases], methods, left_out, out)


def _limits(args: argparse.Namespace) -> Limits:
    given = Limits(args.time_limit, args.memory_limit)
    if not (given.seconds > 0 and given.memory_mb > 0):
        raise BadInput(f"limits of {given.seconds:g} s and {given.memory_mb:g} MB", "more than 0", "raise the limit")
    return given


def _outcome(
    stored: StabilityRows, cases: list[str], methods: tuple[str, ...], left_out: tuple[str, ...], out: Path
) -> Outcome:
    rows = stored.rows(cases, methods)
    files = write_matrix(stored.rows(), out)
    unexpected = [row for row in rows if row["as_expected"] is False]
    lines = [matrix_table(rows).to_text()]
    if left_out:
        lines.append(f"left out, since their data are not here: {', '.join(left_out)}")
    lines.append(f"{len(unexpected)} outcomes not as expected" if unexpected else "every outcome as expected")
    lines += [f"wrote {path}" for path in (stored.path, *files)]
    document = {
        "schema_version": 1,
        "rows": rows,
        "left_out": list(left_out),
        "unexpected": len(unexpected),
        "files": [str(path) for path in (stored.path, *files)],
        "machine": host_facts(),
    }
    return Outcome("\n".join(lines), document, 1 if unexpected else 0)
