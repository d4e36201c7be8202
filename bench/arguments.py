"""The arguments of each verb of the command line. Imports nothing heavy: ``--help`` must be instant."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

__all__ = [
    "add_anchors",
    "add_cameras",
    "add_chart",
    "add_compare",
    "add_depth",
    "add_download",
    "add_list",
    "add_merge",
    "add_report",
    "add_run",
    "add_speed",
    "add_stability",
    "add_sweep",
    "add_table",
    "add_tsed",
    "add_validate",
    "add_verify",
]


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
    parser.add_argument("--codec-match", action="store_true", help="send all frames through VistaDream's H.264 first")
    parser.add_argument("--score-cache", type=Path, metavar="DIR", help="scores by content (cache/scores in the run)")
    _add_llava(parser)
    parser.add_argument("--retry-failed", action="store_true", help="run failed cells and unavailable scores again")
    _add_workers(parser)
    parser.add_argument("--cell-timeout", type=float, metavar="S", help="seconds for a method, or a metric (no limit)")


def add_sweep(parser: argparse.ArgumentParser) -> None:
    add_run(parser)
    parser.description = (
        "Run points of ORCA beside the baselines, and chart speed against accuracy. A point is a method such as "
        "orca@anchors=16384+repair=off; `bench list points` says what may be changed. All options are those of run; "
        "without --methods and --metrics a small list of each."
    )


def add_chart(parser: argparse.ArgumentParser) -> None:
    parser.description = "Draw cost against quality from the files of runs: a panel a score, the Pareto front in words."
    names: dict[str, Any] = {"action": "append", "metavar": "A,B"}
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN", help="folder of a run; all over one data set")
    parser.add_argument("--out", type=Path, metavar="DIR", help="gets PNG, SVG, CSV and Markdown (RUN/chart)")
    parser.add_argument("--metrics", **names, help="panels (every score of the runs)")
    parser.add_argument("--costs", **names, help="of seconds, render_ms_per_frame, memory, bytes (all)")


def add_table(parser: argparse.ArgumentParser) -> None:
    parser.description = "Print the tables of runs from their files, or the paper's published ones, or both."
    columns: dict[str, Any] = {"action": "append", "metavar": "A,B"}
    parser.add_argument("runs", nargs="*", type=Path, metavar="RUN", help="folder of a run")
    parser.add_argument(
        "--published", action="store_true", help="the paper's tables; with RUN, beside what it measured"
    )
    parser.add_argument("--paper", action="store_true", help="the rows and columns of the paper's tables")
    parser.add_argument("--columns", **columns, help="these metrics and costs only")
    parser.add_argument("--intervals", action="store_true", help="95 %% bootstrap intervals behind the means")
    parser.add_argument("--exclude-failed-anywhere", action="store_true", help="also by the paper's rule for failures")
    parser.add_argument("--against", metavar="METHOD", help="this method in the table of pairs (the first)")
    parser.add_argument("--only", metavar="NAME", help="one of the tables: dataset, scenes, pairs, published_tsed, ...")
    formats = ("text", "markdown", "latex", "csv", "json")
    parser.add_argument("--format", choices=formats, default="text", help="how (text); latex is a whole document")
    parser.add_argument("--write", type=Path, metavar="DIR", help="write every format into this folder too")


def add_compare(parser: argparse.ArgumentParser) -> None:
    parser.description = "Say what moved from run A to run B; exit code 1 on a regression."
    limits: dict[str, Any] = {"action": "append", "metavar": "X"}
    parser.add_argument("run_a", type=Path, metavar="RUN_A", help="folder of the run before")
    parser.add_argument("run_b", type=Path, metavar="RUN_B", help="folder of the run after")
    parser.add_argument("--threshold", **limits, help="a share of A's mean (0.01), or METRIC=AMOUNT; may be repeated")
    parser.add_argument("--all", action="store_true", help="show what did not move too")
    parser.add_argument("--format", choices=("text", "markdown"), default="text", help="how (text)")


def add_merge(parser: argparse.ArgumentParser) -> None:
    parser.description = "Put the results of several runs into OUT; two that contradict each other are an error."
    parser.add_argument("out", type=Path, metavar="OUT", help="folder, new or of a run")
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN", help="folder of a run, such as one --shard")


def add_verify(parser: argparse.ArgumentParser) -> None:
    parser.description = "Recheck seals, frames, cameras and inputs of a run; exit code 1 and a line for each fault."
    parser.add_argument("run", type=Path, metavar="RUN", help="folder of a run")
    parser.add_argument("--data-root", type=Path, metavar="DIR", help="where the data lie now (where they lay then)")
    parser.add_argument("--quick", action="store_true", help="do not decode the stored frames")


def add_anchors(parser: argparse.ArgumentParser) -> None:
    parser.description = "Quality against anchors on each scene's image: regular grids, and grown by residual."
    parser.add_argument("--scenes", action="append", metavar="A,B", help="scenes, separated by commas (all)")
    parser.add_argument("--target-psnr", type=float, default=40.0, metavar="DB", help="where a curve ends (40)")
    parser.add_argument("--price", type=float, default=0.1, metavar="DB", help="a thousand anchors' least gain (0.1)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="write the chart, its figures and a page there")
    _add_dataset(parser)


def add_speed(parser: argparse.ArgumentParser) -> None:
    parser.description = "Time renderer and trainer, fast against reference in one process, on an embedded photograph."
    names: dict[str, Any] = {"action": "append", "metavar": "A,B"}
    parser.add_argument("--cases", **names, help="frame, fit, step, stage3 (these), init, scenes, tsed, musiq, clipiqa")
    parser.add_argument("--quick", action="store_true", help="under a minute, without peak memory (else half an hour)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="write tables, rows and the chart there too")
    chart = parser.add_argument_group("the cases init and scenes")
    chart.add_argument("--scenes", **names, help="scenes (init: the data set's first three; scenes: all)")
    chart.add_argument(
        "--iterations", type=int, default=500, metavar="N", help="gradient steps of each fit of init (500)"
    )
    _add_dataset(parser)


def add_validate(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Say of each scene below PATH what is there, and the first problem; exit code 1 if there is one."
    )
    parser.add_argument("path", metavar="PATH", help="a folder, or KIND:PATH as for run --methods")
    parser.add_argument("--scenes", action="append", metavar="A,B", help="scenes (all)")
    _add_dataset(parser)
    parser.add_argument("--trajectory", metavar="NAME", help="camera path, or a .json file (the data set's own)")
    parser.set_defaults(dataset=None)


def add_cameras(parser: argparse.ArgumentParser) -> None:
    parser.description = "Write each scene's image and cameras.json: what another method renders along."
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="gets a folder for each scene")
    parser.add_argument("--scenes", action="append", metavar="A,B", help="scenes (all)")
    _add_dataset(parser)
    parser.add_argument("--trajectory", metavar="NAME", help="camera path, or a .json file (the data set's own)")


def add_download(parser: argparse.ArgumentParser) -> None:
    parser.description = "Fetch what is missing of a data set into the data root; every file is checked by its SHA-256."
    parser.add_argument("what", metavar="NAME", help="realmdreamer, vistadream, div2k, or weights")
    parser.add_argument("--data-root", type=Path, metavar="DIR", help="data ($ORCA_DATA_ROOT, ./data, the user cache)")
    parser.add_argument(
        "--dry-run", action="store_true", help="say what would be fetched from where, and fetch nothing"
    )


def add_depth(parser: argparse.ArgumentParser) -> None:
    parser.description = "Rebuild realmdreamer/depth/*.png from VistaDream's depth videos in vistadream/dpt/."
    parser.add_argument("--data-root", type=Path, metavar="DIR", help="data ($ORCA_DATA_ROOT, ./data, the user cache)")
    parser.add_argument("--scenes", action="append", metavar="A,B", help="scenes (all)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="where to write (DATA_ROOT/realmdreamer/depth)")


def add_report(parser: argparse.ArgumentParser) -> None:
    parser.description = "Write a run as one HTML page that needs no network: tables, chart, videos, failures."
    parser.add_argument("run", type=Path, metavar="RUN", help="folder of a run")
    parser.add_argument("--out", type=Path, metavar="FILE", help="page to write (RUN/report.html)")
    parser.add_argument("--data-root", type=Path, metavar="DIR", help="where the data lie now (where they lay then)")
    parser.add_argument("--stability", type=Path, metavar="JSON", help="rows of bench stability (found beside the run)")
    parser.add_argument("--max-mb", type=float, default=30.0, metavar="MB", help="largest page; videos shrink (30)")


def add_stability(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Run methods on inputs that break them, each in a process with limits; exit code 1 where an outcome is not one "
        "of those expected. Finished cells are never redone."
    )
    names: dict[str, Any] = {"action": "append", "metavar": "A,B"}
    parser.add_argument("--methods", **names, help="methods (orca, warp, warp-telea)")
    parser.add_argument("--cases", **names, help="cases or groups of cases (all whose data are here)")
    curves = "instead, quality against noise, scale, fov, seed, jpeg (all of them, or those named)"
    parser.add_argument("--curves", nargs="?", const="all", metavar="A,B", help=curves)
    scene = "of the curves, one with true views (photos/motorcycle)"
    parser.add_argument("--scene", default="photos/motorcycle", metavar="DATASET/SCENE", help=scene)
    parser.add_argument("--preset", default="draft", help="preset of ORCA (draft)")
    parser.add_argument("--time-limit", type=float, default=300.0, metavar="S", help="CPU seconds for a cell (300)")
    parser.add_argument("--memory-limit", type=float, default=8000.0, metavar="MB", help="resident memory (8000)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder of the run (runs/stability)")
    parser.add_argument("--retry-unexpected", action="store_true", help="run cells again that were not as expected")


def add_list(parser: argparse.ArgumentParser) -> None:
    what = ("datasets", "methods", "points", "metrics", "trajectories", "scenes")
    parser.add_argument("what", choices=what, metavar="WHAT", help=", ".join(what))
    _add_dataset(parser)


def _add_workers(parser: argparse.ArgumentParser) -> None:
    """Who does the work; results do not depend on it. The defaults are those of `bench.executors`."""
    group = parser.add_argument_group("workers", "A scene is one task; any mix of these goes on where another stopped.")
    group.add_argument("--jobs", type=int, metavar="N", help="scenes at a time (1; on a cluster as many as it takes)")
    group.add_argument("--shard", metavar="I/N", help="the I-th of N parts of the data set; bench merge joins them")
    group.add_argument("--executor", choices=("local", "ray", "slurm"), default="local", help="where (local)")
    group.add_argument("--address", metavar="HOST:PORT", help="of a Ray cluster, or auto (a new one on this machine)")
    group.add_argument("--cores-per-scene", type=int, metavar="N", help="cores (local: divided by the jobs; else 1)")
    group.add_argument("--memory-per-scene", type=float, metavar="GIB", help="memory one scene needs at its peak")
    group.add_argument("--gpus-per-scene", type=float, metavar="N", help="GPUs (1 with --device cuda, else 0)")
    option: dict[str, Any] = {"action": "append", "metavar": "KEY=VALUE"}
    group.add_argument("--slurm", **option, help="for submitit: slurm_partition=gpu, timeout_min=240, cluster=local")


def _add_llava(parser: argparse.ArgumentParser) -> None:
    """The server of LLaVA-IQA; the numbers' defaults are those of `bench.metrics.llava_endpoint.LlavaEndpoint`."""
    parser.add_argument("--llava-url", metavar="URL", help="OpenAI-compatible server for LLaVA-IQA (this machine)")
    parser.add_argument("--llava-model", metavar="NAME", help="the model's name on that server")
    parser.add_argument("--llava-concurrency", type=int, metavar="N", help="requests at a time (4)")
    parser.add_argument("--llava-timeout", type=float, metavar="S", help="seconds for a request (60)")


def add_tsed(parser: argparse.ArgumentParser) -> None:
    parser.description = "Print what a run's TSED is worth: pooled, per scene, nulls, and the grid of thresholds."
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN", help="folder of a run")
    parser.add_argument("--write", type=Path, metavar="DIR", help="write the tables into this folder too")


def _add_dataset(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--dataset", default="photos", metavar="NAME", help="photos, realmdreamer or folder (photos)")
    parser.add_argument("--images", type=Path, metavar="DIR", help="images, for --dataset folder")
    parser.add_argument("--data-root", type=Path, metavar="DIR", help="data ($ORCA_DATA_ROOT, ./data, the user cache)")
