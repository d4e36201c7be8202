"""The options of ``bench run`` that say who does the work."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from bench.executors import Executor, InThisProcess, Resources
from bench.executors.executor import DEFAULT_MEMORY_GIB
from orca.errors import BadInput

__all__ = ["chosen_executor", "what_is_run"]

_OPTIONS = (
    "--jobs",
    "--shard",
    "--executor",
    "--address",
    "--cores-per-scene",
    "--memory-per-scene",
    "--gpus-per-scene",
    "--slurm",
)


def what_is_run(argv: Sequence[str]) -> list[str]:
    """The command line without what says who does it: parts of one run have one command."""
    kept: list[str] = []
    words = iter(argv)
    for word in words:
        if word in _OPTIONS:
            next(words, None)
        elif word.partition("=")[0] not in _OPTIONS and word not in ("--json", "--debug"):
            kept.append(word)
    return kept


def chosen_executor(args: argparse.Namespace) -> Executor:
    """The executor that the options name.

    Raises:
        BadInput: options that do not go together, or make no sense.
        Unavailable: the package of a cluster is not installed.
    """
    gpus = args.gpus_per_scene
    resources = Resources(
        args.cores_per_scene,
        DEFAULT_MEMORY_GIB if args.memory_per_scene is None else args.memory_per_scene,
        float(args.device.startswith("cuda")) if gpus is None else gpus,
    )
    if args.jobs is not None and args.jobs < 1:
        raise BadInput(f"--jobs {args.jobs}", "1 or more", "give 1 for one scene after another")
    for option, executor in (("address", "ray"), ("slurm", "slurm")):
        if getattr(args, option) is not None and args.executor != executor:
            raise BadInput(f"--{option} with --executor {args.executor}", f"--executor {executor}", "add it")
    if args.executor == "ray":
        from bench.executors.ray_cluster import RayCluster

        return RayCluster(args.address, args.jobs, resources)
    if args.executor == "slurm":
        from bench.executors.slurm import Slurm, parse_options

        return Slurm(args.jobs, resources, parse_options(args.slurm))
    if args.jobs is None or args.jobs == 1:
        return InThisProcess()
    from bench.executors.local import LocalWorkers

    return LocalWorkers(args.jobs, resources)
