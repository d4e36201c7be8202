"""``bench validate``: can these frames, videos or splats be measured?"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial

from bench.commands.names import chosen, split_names
from bench.commands.outcome import Outcome
from bench.datasets import Dataset, SceneCase, open_dataset
from bench.validation import SceneReport, detected, inspect_scene, scene_names
from orca.errors import BadInput

__all__ = ["validate_command"]


def validate_command(args: argparse.Namespace) -> Outcome:
    """Look at every scene; exit code 1 if one of them has a problem.

    With ``--dataset`` the scenes are those of the data set, and cameras and placement are checked against it; without,
    they are those of the folder, each held against itself.

    Raises:
        BadInput: no such folder, nothing in it that is known, or no scene.
    """
    spec = detected(args.path)
    dataset = None
    if args.dataset is not None:
        dataset = open_dataset(args.dataset, data_root=args.data_root, images=args.images, trajectory=args.trajectory)
    known = scene_names(spec) if dataset is None else tuple(dataset.scenes())
    scenes = chosen("scene", args.scenes, known, known) if dataset is not None else split_names(args.scenes) or known
    if not scenes:
        raise BadInput(f"no scene in {spec.path}", "one entry a scene", "check the path, or use KIND:PATH")
    reports = [inspect_scene(spec, scene, _loader(dataset, scene)) for scene in scenes]
    broken = [report for report in reports if report.problem is not None]
    summary = f"{len(scenes) - len(broken)} of {len(scenes)} scenes usable as {spec.kind}"
    if dataset is None:
        summary += "; cameras not compared with a data set's (--dataset NAME does)"
    document = {
        "schema_version": 1,
        "path": str(spec.path),
        "kind": spec.kind,
        "dataset": args.dataset,
        "usable": not broken,
        "scenes": [report.to_json() for report in reports],
    }
    return Outcome("\n".join([*map(_line, reports), summary]), document, 1 if broken else 0)


def _loader(dataset: Dataset | None, scene: str) -> Callable[[], SceneCase] | None:
    return None if dataset is None else partial(dataset.load, scene)


def _line(report: SceneReport) -> str:
    facts = []
    if report.frames is not None:
        size = "" if report.size is None else f" of {report.size[0]}x{report.size[1]}"
        facts.append(f"{report.frames} frames{size}")
    if report.splats is not None:
        facts.append(f"{report.splats} splats")
    if report.first:
        facts.append(f"{report.first} to {report.last}" if report.last else report.first)
    if report.cameras is not None:
        facts.append(f"{report.cameras} cameras {(report.cameras_sha256 or '')[:12]}".rstrip())
    line = f"{report.scene}: {', '.join(facts) or 'nothing'}"
    return f"{line}; ok" if report.problem is None else f"{line}\n  problem: {report.problem}\n  to do:   {report.fix}"
