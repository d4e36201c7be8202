"""The command line of the bench: arguments, exit codes, and the one place that prints.

Exit codes: 0 done, 1 some cell failed, 2 bad input, 130 interrupted. With ``--json`` stdout carries one JSON document
and nothing else; logs, bars and errors go to stderr.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import json
import logging
import os
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from orca.errors import OrcaError

if TYPE_CHECKING:
    from bench.commands.outcome import Outcome

__all__ = ["build_parser", "main"]

_VERBS = {
    "run": "bench.commands.run:run_command",
    "table": "bench.commands.table:table_command",
    "list": "bench.commands.list:list_command",
}


def build_parser() -> argparse.ArgumentParser:
    """The parser, built without importing any of the code it leads to."""
    parser = argparse.ArgumentParser(
        prog="python -m bench", description="Judge single-image 3D methods along the same cameras."
    )
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument("--json", action="store_true", help="print one JSON document on stdout, all else on stderr")
    common.add_argument("--debug", action="store_true", help="show tracebacks and what is computed why")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="VERB")
    _add_run(verbs.add_parser("run", parents=[common], help="compute what is missing of a run, print its tables"))
    _add_table(verbs.add_parser("table", parents=[common], help="print tables of a run, or the paper's, from files"))
    _add_list(verbs.add_parser("list", parents=[common], help="say which data sets, methods, ... there are"))
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    given = list(sys.argv[1:] if argv is None else argv)
    args = build_parser().parse_args(given)
    args.argv = given
    logging.basicConfig(stream=sys.stderr, level=logging.WARNING, format="%(levelname)s %(name)s: %(message)s")
    logging.getLogger("bench").setLevel(logging.DEBUG if args.debug else logging.INFO)
    try:
        with contextlib.redirect_stdout(sys.stderr):  # libraries that print must not break the document
            outcome = _call(args)
    except OrcaError as error:
        return _report(error, args)
    except KeyboardInterrupt:
        print("interrupted: finished work is kept, the same command goes on from here", file=sys.stderr)
        return 130
    return _print(json.dumps(outcome.document, indent=1) if args.json else outcome.text, outcome.exit_code)


def _call(args: argparse.Namespace) -> Outcome:
    module, _, function = _VERBS[args.verb].partition(":")
    outcome: Outcome = getattr(importlib.import_module(module), function)(args)
    return outcome


def _print(text: str, exit_code: int) -> int:
    try:
        print(text.rstrip("\n"), flush=True)
    except BrokenPipeError:  # `| head` has seen enough; keep Python from complaining at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return exit_code


def _report(error: OrcaError, args: argparse.Namespace) -> int:
    if args.debug:
        traceback.print_exception(error, file=sys.stderr)
    print(f"error: {error}", file=sys.stderr)
    if args.json:
        message = {"kind": error.kind, "given": error.given, "allowed": error.allowed, "fix": error.fix}
        return _print(json.dumps({"schema_version": 1, "error": message}, indent=1), 2)
    return 2


def _add_run(parser: argparse.ArgumentParser) -> None:
    parser.description = "Compute what is missing, one JSON for each method and scene; finished work is never redone."
    names: dict[str, Any] = {"action": "append", "metavar": "A,B"}
    _add_dataset(parser)
    parser.add_argument("--trajectory", metavar="NAME", help="camera path, or a .json file (the data set's own)")
    parser.add_argument("--scenes", **names, help="scenes, separated by commas, or repeated (all)")
    parser.add_argument("--methods", **names, help="methods (those that make sense for the data set)")
    parser.add_argument("--metrics", **names, help="metrics (all)")
    parser.add_argument("--preset", default="draft", help="preset of ORCA (draft)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder of the run (runs/DATASET-PRESET)")
    parser.add_argument("--weights-dir", type=Path, metavar="DIR", help="weights of metrics (DATA_ROOT/weights)")
    parser.add_argument("--device", default="cpu", help="cpu or cuda (cpu)")
    parser.add_argument("--seed", type=int, default=0, help="the random seed (0)")
    parser.add_argument("--retry-failed", action="store_true", help="run failed cells and unavailable scores again")


def _add_table(parser: argparse.ArgumentParser) -> None:
    parser.description = "Print the tables of one or more runs from their files, or the paper's published ones."
    parser.add_argument("runs", nargs="*", type=Path, metavar="RUN", help="folder of a run")
    parser.add_argument("--published", action="store_true", help="the paper's three tables")
    parser.add_argument("--format", choices=("text", "markdown", "csv"), default="text", help="how (text)")


def _add_list(parser: argparse.ArgumentParser) -> None:
    what = ("datasets", "methods", "metrics", "trajectories", "scenes")
    parser.add_argument("what", choices=what, metavar="WHAT", help=", ".join(what))
    _add_dataset(parser)


def _add_dataset(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--dataset", default="photos", metavar="NAME", help="photos, realmdreamer or folder (photos)")
    parser.add_argument("--images", type=Path, metavar="DIR", help="images, for --dataset folder")
    parser.add_argument("--data-root", type=Path, metavar="DIR", help="data ($ORCA_DATA_ROOT, ./data, the user cache)")
