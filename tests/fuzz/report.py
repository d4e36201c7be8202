"""The table of fuzzing: minutes, executions and findings by target, from the lines that runs left."""

from __future__ import annotations

import json
from collections import defaultdict
from pathlib import Path

from tests.fuzz.targets import TARGETS

__all__ = ["write_report"]

_DOCS = Path(__file__).resolve().parents[2] / "docs"
_HEAD = """# Fuzzing

`python -m tests.fuzz TARGET --seconds N` (Atheris; coverage of the Python code, not of compiled decoders).
A finding is an input on which a parser raised anything but its own error, crashed, hung for ten minutes, or took two
gigabytes. Findings that were fixed are kept in `tests/fuzz/corpus` and read again by every test run.

| target | what reads it | minutes | of a core | executions | places found |
|---|---|---:|---:|---:|---:|
"""


def write_report(runs: Path) -> Path:
    """Write docs/fuzzing.md; return its path."""
    seconds: defaultdict[str, float] = defaultdict(float)
    cpu: defaultdict[str, float] = defaultdict(float)
    executions: defaultdict[str, int] = defaultdict(int)
    found: defaultdict[str, set[str]] = defaultdict(set)
    for line in runs.read_text().splitlines():
        run = json.loads(line)
        seconds[run["target"]] += run["seconds"]
        cpu[run["target"]] += run.get("cpu_seconds", 0)
        executions[run["target"]] += run["executions"]
        found[run["target"]] |= {name for name in run["findings"] if not name.endswith(".txt")}
    rows = [
        f"| {name} | {target.reads} | {seconds[name] / 60:.1f} | {cpu[name] / 60:.1f} | {executions[name]:,} "
        f"| {len(found[name])} |"
        for name, target in TARGETS.items()
    ]
    minutes = f"{sum(seconds.values()) / 60:.1f} | {sum(cpu.values()) / 60:.1f}"
    total = f"| all | | {minutes} | {sum(executions.values()):,} | |"
    path = _DOCS / "fuzzing.md"
    path.parent.mkdir(exist_ok=True)
    notes = path.with_name("fuzzing_notes.md")
    tail = "\n" + notes.read_text() if notes.is_file() else ""
    path.write_text(_HEAD + "\n".join([*rows, total]) + "\n" + tail)
    return path
