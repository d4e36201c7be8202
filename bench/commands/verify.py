"""``bench verify``: does a run's folder still hold what was measured?"""

from __future__ import annotations

import argparse
from dataclasses import asdict

from bench.commands.outcome import Outcome
from bench.verify import Verification, verify_run

__all__ = ["verify_command"]


def verify_command(args: argparse.Namespace) -> Outcome:
    """Check a run; exit code 1 with a line for each fault. Raises `BadInput` where there is no run."""
    found = verify_run(args.run, args.data_root, not args.quick)
    document = {
        "schema_version": 1,
        "run": str(args.run),
        "records": found.records,
        "scenes_checked": found.inputs,
        "faults": [asdict(fault) for fault in found.faults],
        "notes": list(found.notes),
    }
    return Outcome("\n".join(_lines(found)), document, 1 if found.faults else 0)


def _lines(found: Verification) -> list[str]:
    lines = [f"{fault.file}: {fault.kind}: {fault.what}" for fault in found.faults]
    lines += [f"note: {note}" for note in found.notes]
    count = f"{len(found.faults)} faults" if found.faults else "as measured"
    return [*lines, f"{found.records} results, inputs of {found.inputs} scenes: {count}"]
