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
from bench.host import host_facts
from bench.speed.case import CASES, THREADS, CaseName, Setting, full_plan, quick_plan
from bench.speed.measure import SpeedRow, measure
from bench.speed.scaling import scaling_exponents
from bench.speed.table import exponent_lines, machine_line, ratio_lines, speed_table
from bench.speed.threads import available_threads
from bench.speed.workshop import Workshop
from orca.atomic import atomic_path

__all__ = ["speed_command"]


def speed_command(args: argparse.Namespace) -> Outcome:
    """Time the cases asked for. With ``--out`` rows are written as they come, so an interrupted run keeps them."""
    cases = cast(tuple[CaseName, ...], chosen("case", args.cases, CASES, CASES))
    plan = _plan(cases, args.quick)
    load_before = _load()
    with tempfile.TemporaryDirectory(prefix="orca-speed-") as folder:
        rows, ratios = measure(plan, Workshop(Path(folder)), lambda rows: _keep(rows, args.out))
    machine = {**host_facts(), "load": {"before": load_before, "after": _load()} if load_before is not None else None}
    exponents = scaling_exponents(rows)
    document = {
        "schema_version": 1,
        "machine": machine,
        "rows": [row.to_json() for row in rows],
        "ratios": [ratio.to_json() for ratio in ratios],
        "exponents": [exponent.to_json() for exponent in exponents],
    }
    table = speed_table(rows)
    lines = [table.to_text(), *ratio_lines(ratios), *exponent_lines(exponents), machine_line(machine)]
    if args.out is not None:
        tail = "\n".join(f"- {line}" for line in lines[1:])
        _write(args.out / "speed.md", f"{table.to_markdown()}\n{tail}\n")
        _write(args.out / "speed.json", json.dumps(document, indent=1))
        lines.append(f"wrote {args.out / 'speed.md'}, {args.out / 'speed.json'}")
    return Outcome("\n".join(lines), document)


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
