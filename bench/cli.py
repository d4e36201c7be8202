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
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from bench import arguments
from orca.errors import OrcaError

if TYPE_CHECKING:
    from bench.commands.outcome import Outcome

__all__ = ["build_parser", "main"]

# What each verb is for, its arguments, and the function that does it, imported when it is called.
_VERBS: dict[str, tuple[str, Callable[[argparse.ArgumentParser], None], str]] = {
    "run": ("compute what is missing of a run, print its tables", arguments.add_run, "run:run_command"),
    "table": ("print tables of a run, or the paper's, from files", arguments.add_table, "table:table_command"),
    "tsed": ("print a run's TSED: pooled, nulls, grid", arguments.add_tsed, "tsed:tsed_command"),
    "compare": ("say what moved between two runs", arguments.add_compare, "compare:compare_command"),
    "merge": ("put parts of a run together", arguments.add_merge, "merge:merge_command"),
    "verify": ("find edited results and stale inputs of a run", arguments.add_verify, "verify:verify_command"),
    "speed": ("time renderer and trainer, fast against reference", arguments.add_speed, "speed:speed_command"),
    "stability": (
        "run methods on inputs that break them",
        arguments.add_stability,
        "stability:stability_command",
    ),
    "anchors": ("chart quality against anchors", arguments.add_anchors, "anchors:anchors_command"),
    "validate": (
        "say whether a folder of frames or splats is usable",
        arguments.add_validate,
        "validate:validate_command",
    ),
    "cameras": ("write the cameras to render along", arguments.add_cameras, "cameras:cameras_command"),
    "download": ("fetch data sets, checked by their hashes", arguments.add_download, "download:download_command"),
    "depth": ("rebuild depth maps from published videos", arguments.add_depth, "download:depth_command"),
    "sweep": ("run points of ORCA and the baselines, chart them", arguments.add_sweep, "sweep:sweep_command"),
    "chart": ("draw speed against accuracy", arguments.add_chart, "chart:chart_command"),
    "report": ("write a run as one page", arguments.add_report, "report:report_command"),
    "list": ("say which data sets, methods, ... there are", arguments.add_list, "list:list_command"),
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
    for verb, (help_text, add_arguments, _) in _VERBS.items():
        add_arguments(verbs.add_parser(verb, parents=[common], help=help_text))
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
    module, _, function = _VERBS[args.verb][2].partition(":")
    outcome: Outcome = getattr(importlib.import_module(f"bench.commands.{module}"), function)(args)
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
