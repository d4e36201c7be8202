"""``bench speed``: renderer and trainer, fast against reference in the same run."""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

from bench.commands.names import chosen
from bench.commands.outcome import Outcome
from bench.datasets.case import SceneCase
from bench.datasets.catalogue import open_dataset
from bench.host import host_facts
from bench.speed.case import CASES, THREADS, CaseName, Setting, full_plan, quick_plan
from bench.speed.chart import write_chart, write_csv
from bench.speed.initialisation import INITIALISATIONS, fit_curve
from bench.speed.measure import SpeedRow, measure
from bench.speed.scaling import scaling_exponents
from bench.speed.table import exponent_lines, machine_line, ratio_lines, speed_table
from bench.speed.threads import available_threads
from bench.speed.workshop import Workshop
from orca.atomic import atomic_path
from orca.errors import BadInput

__all__ = ["speed_command"]

_CHART = "init"
_SCENES = "scenes"
_TSED = "tsed"
_LEARNED = ("musiq", "clipiqa")


def speed_command(args: argparse.Namespace) -> Outcome:
    """Time the cases asked for. With ``--out`` rows are written as they come, so an interrupted run keeps them.

    Raises:
        Unknown: no such case, data set or scene.
        BadInput: no or negative iterations.
    """
    names = chosen("case", args.cases, (*CASES, _CHART, _SCENES, _TSED, *_LEARNED), CASES)
    cases = cast(tuple[CaseName, ...], tuple(name for name in names if name in CASES))
    scenes = _scenes(args, 3) if _CHART in names else []
    whole = _scenes(args, 1 if args.quick else None) if _SCENES in names else []
    load = _load()
    document: dict[str, Any] = {"schema_version": 1}
    lines: list[str] = []
    if cases:
        _grid(_plan(cases, args.quick), args.out, document, lines)
    if "stage3" in cases and not args.quick:
        _stage3(document, lines)
    if scenes:
        _chart(scenes, args, document, lines)
    if whole:
        _whole(whole, args, document, lines)
    if _TSED in names:
        _tsed(args.quick, document, lines)
    for case in (name for name in names if name in _LEARNED):
        _learned(case, args.quick, document, lines)
    document["machine"] = host_facts() | {"load": {"before": load, "after": _load()} if load is not None else None}
    lines.append(machine_line(document["machine"]))
    if args.out is not None:
        _write(args.out / "speed.json", json.dumps(document, indent=1))
        lines.append(f"wrote {args.out}")
    return Outcome("\n".join(lines), document)


def _grid(plan: Sequence[Setting], out: Path | None, document: dict[str, Any], lines: list[str]) -> None:
    """Time a plan; add what was found to the document and to the lines."""
    with tempfile.TemporaryDirectory(prefix="orca-speed-") as folder:
        rows, ratios = measure(plan, Workshop(Path(folder)), lambda rows: _keep(rows, out))
    exponents = scaling_exponents(rows)
    document["rows"] = [row.to_json() for row in rows]
    document["ratios"] = [ratio.to_json() for ratio in ratios]
    document["exponents"] = [exponent.to_json() for exponent in exponents]
    table, findings = speed_table(rows), [*ratio_lines(ratios), *exponent_lines(exponents)]
    lines += [table.to_text(), *findings]
    if out is not None:
        _write(out / "speed.md", table.to_markdown() + "\n" + "".join(f"- {line}\n" for line in findings))


def _stage3(document: dict[str, Any], lines: list[str]) -> None:
    """Stage 3 at the size that its target is stated for: 50 views, 20 repairs."""
    from bench.speed.stage3 import measure_stage3, stage3_line

    document["stage3"] = measure_stage3()
    lines.append(stage3_line(document["stage3"]))


def _whole(scenes: Sequence[SceneCase], args: argparse.Namespace, document: dict[str, Any], lines: list[str]) -> None:
    """Fits and whole reconstructions of real scenes, each in a process of its own."""
    from bench.speed.scenes import SceneRow, measure_scenes, scenes_table

    found: list[SceneRow] = []

    def keep(row: SceneRow) -> None:
        found.append(row)
        if args.out is not None:
            kept = {"schema_version": 1, "rows": [r.to_json() for r in found]}
            _write(args.out / "scenes.json", json.dumps(kept, indent=1))

    rows = measure_scenes(scenes, min(THREADS[-1], available_threads()), args.quick, keep)
    document["rows"] = [*document.get("rows", []), *(row.to_json() for row in rows)]
    table = scenes_table(rows)
    lines.append(table.to_text())
    if args.out is not None:
        _write(args.out / "scenes.md", table.to_markdown())


def _tsed(quick: bool, document: dict[str, Any], lines: list[str]) -> None:
    """Time TSED against naive OpenCV on the same frames."""
    from bench.speed.consistency import measure_consistency, tsed_line

    with tempfile.TemporaryDirectory(prefix="orca-speed-") as folder:
        speed = measure_consistency(Workshop(Path(folder)), min(THREADS[-1], available_threads()), 1 if quick else 3)
    document["tsed"] = speed.to_json()
    lines.append(tsed_line(speed))


def _learned(case: str, quick: bool, document: dict[str, Any], lines: list[str]) -> None:
    """Time a learned metric against pyiqa: 50 frames, or 10."""
    from bench.metrics.learned_speed import measure_learned_speed

    for speed in measure_learned_speed(case, frames=10 if quick else 50, threads=min(2, available_threads())):
        document.setdefault("learned_metrics", []).append(speed.to_json())
        lines.append(speed.line())


def _chart(scenes: Sequence[SceneCase], args: argparse.Namespace, document: dict[str, Any], lines: list[str]) -> None:
    """Fit scenes from both initialisations; draw them if there is a folder to draw in."""
    for initialisation in INITIALISATIONS:
        fit_curve(scenes[0], initialisation, 1)  # compiles, and warms up
    curves = [fit_curve(scene, name, args.iterations) for scene in scenes for name in INITIALISATIONS]
    document["initialisation"] = [curve.to_json() for curve in curves]
    lines += [
        f"{curve.scene}, {curve.initialisation}: {point.psnr:.2f} dB after {point.cpu_s:.2f} CPU-s "
        f"({point.solver_steps} solver steps, {point.iterations} gradient steps)"
        for curve in curves
        for point in curve.points
    ]
    if args.out is not None:
        write_csv(curves, args.out / "initialisation.csv")
        write_chart(curves, args.out / "initialisation.png")


def _scenes(args: argparse.Namespace, first: int | None) -> list[SceneCase]:
    """The scenes named, or the first few of the data set; all of them for None."""
    if args.iterations < 0:
        raise BadInput(f"--iterations {args.iterations}", "0 or more", "give another number")
    dataset = open_dataset(args.dataset, data_root=args.data_root, images=args.images)
    known = tuple(dataset.scenes())
    return [dataset.load(name) for name in chosen("scene", args.scenes, known, known[:first])]


def _plan(cases: Sequence[CaseName], quick: bool) -> tuple[Setting, ...]:
    """The plan, without the thread counts that this machine does not have."""
    most = available_threads()
    if quick:
        return quick_plan(cases, min(THREADS[-1], most))
    return full_plan(cases, [n for n in THREADS if n <= most])


def _keep(rows: list[SpeedRow], out: Path | None) -> None:
    if out is not None:
        document: dict[str, Any] = {"schema_version": 1, "rows": [row.to_json() for row in rows]}
        _write(out / "speed.json", json.dumps(document, indent=1))


def _load() -> float | None:
    """Processes that want a core, mean of the last minute: above the number of cores, times say little."""
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else None


def _write(path: Path, text: str) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
