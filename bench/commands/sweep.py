"""``bench sweep``: a run over points of ORCA and the baselines, and its chart of speed against accuracy."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from bench.adapters import METHODS, RunOptions
from bench.adapters.points import SWEEP
from bench.commands.chart import draw_runs
from bench.commands.names import split_names
from bench.commands.outcome import Outcome
from bench.commands.run import run_command
from bench.store import RunStore

__all__ = ["SWEEP_METRICS", "sweep_command", "sweep_methods"]

SWEEP_METRICS = ("input_psnr", "psnr", "niqe", "tsed", "tsed_median_sed", "hole_fraction")
"""What a sweep measures unless told otherwise: nothing that needs a GPU or large weights."""

_WARM_UP = ("orca@anchors=512", "orca@anchors=512+decode=per_hit+iterations=1")


def sweep_methods(dataset: str) -> tuple[str, ...]:
    """The points of ORCA, what a user would do by hand, and published frames where there are any."""
    published = ("vistadream",) if dataset == "realmdreamer" else ()
    return (*SWEEP, "warp", "warp-telea", *published)


def sweep_command(args: argparse.Namespace) -> Outcome:
    """Run what is missing of the sweep, then draw the chart of the whole folder into its ``chart/``.

    Raises:
        Unknown: no such method, point, key, metric or scene.
        BadInput: a value that a point does not allow; another run in the folder.
    """
    methods = split_names(args.methods) or sweep_methods(args.dataset)
    args.methods = list(methods)
    args.metrics = args.metrics or list(SWEEP_METRICS)
    args.out = args.out or Path("runs") / f"{args.dataset}-{args.preset}-sweep"
    if any(METHODS.check(name).startswith("orca") for name in methods) and _is_new(args.out, methods):
        _warm_up(args.device)
    run = run_command(args)
    chart = draw_runs([args.out], args.out / "chart")
    document = {"schema_version": 1, "run": run.document, "chart": chart.document}
    return Outcome(f"{run.text}\n\n{chart.text}", document, run.exit_code)


def _is_new(out: Path, methods: Sequence[str]) -> bool:
    """Whether some method has no result there yet."""
    done = {path.parent.name for path in RunStore(out).record_paths()}
    return any(name not in done for name in methods)


def _warm_up(device: str) -> None:
    """Load libraries and compiled kernels on a tiny scene, so that the first point is not charged with them."""
    from bench.datasets.synthetic import Synthetic

    case = Synthetic(size=64).load("predictable-00")
    for name in _WARM_UP:
        METHODS.get(name).run(case, RunOptions(device=device))
