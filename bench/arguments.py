"""The arguments of each verb of the command line. Imports nothing heavy: ``--help`` must be instant."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

__all__ = ["add_list", "add_run", "add_table"]


def add_run(parser: argparse.ArgumentParser) -> None:
    parser.description = "Compute what is missing, one JSON for each method and scene; finished work is never redone."
    names: dict[str, Any] = {"action": "append", "metavar": "A,B"}
    _add_dataset(parser)
    parser.add_argument("--trajectory", metavar="NAME", help="camera path, or a .json file (the data set's own)")
    parser.add_argument("--scenes", **names, help="scenes, separated by commas, or repeated (all)")
    parser.add_argument("--methods", **names, help="methods, or your own as NAME=KIND:PATH")
    parser.add_argument("--metrics", **names, help="metrics (all)")
    parser.add_argument("--preset", default="draft", help="preset of ORCA (draft)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder of the run (runs/DATASET-PRESET)")
    parser.add_argument("--weights-dir", type=Path, metavar="DIR", help="weights of metrics (DATA_ROOT/weights)")
    parser.add_argument("--device", default="cpu", help="cpu or cuda (cpu)")
    parser.add_argument("--seed", type=int, default=0, help="the random seed (0)")
    parser.add_argument("--retry-failed", action="store_true", help="run failed cells and unavailable scores again")


def add_table(parser: argparse.ArgumentParser) -> None:
    parser.description = "Print the tables of one or more runs from their files, or the paper's published ones."
    parser.add_argument("runs", nargs="*", type=Path, metavar="RUN", help="folder of a run")
    parser.add_argument("--published", action="store_true", help="the paper's three tables")
    parser.add_argument("--format", choices=("text", "markdown", "csv"), default="text", help="how (text)")


def add_list(parser: argparse.ArgumentParser) -> None:
    what = ("datasets", "methods", "metrics", "trajectories", "scenes")
    parser.add_argument("what", choices=what, metavar="WHAT", help=", ".join(what))
    _add_dataset(parser)


def _add_dataset(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--dataset", default="photos", metavar="NAME", help="photos, realmdreamer or folder (photos)")
    parser.add_argument("--images", type=Path, metavar="DIR", help="images, for --dataset folder")
    parser.add_argument("--data-root", type=Path, metavar="DIR", help="data ($ORCA_DATA_ROOT, ./data, the user cache)")
