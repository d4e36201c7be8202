"""Where faults are injected: a process that runs jobs, a run's folder, and the words for what was seen there."""

from __future__ import annotations

import json
import re
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.record import FAILED, CellRecord
from tests.faults.forks import Forks, Outcome
from tests.faults.snapshot import finished_cells, half_written, snapshot

__all__ = ["KINDS", "Told", "Workbench", "ended", "recorded", "records"]

# The kinds of file that a run writes.
KINDS = {
    "run": "*/run.json",
    "frames": "*/frames/*/*.npz",
    "cameras": "*/trajectories/*.json",
    "result": "*/scenes/*/*.json",
    "score cache": "*/cache/scores/*/*.json",
    "long table": "*/scores.parquet",
    "table": "*/tables/*",
}


@dataclass(frozen=True)
class Told:
    """What came of a fault: in words made of what was observed, and what was lost (nothing, if all is well)."""

    happened: str
    lost: tuple[str, ...]


class Workbench:
    """A process that runs jobs, a folder, and the files of a run that nothing befell.

    Args:
        forks: runs `tests.faults.jobs.bench_job`.
        folder: empty.
    """

    def __init__(self, forks: Forks, folder: Path) -> None:
        self.forks, self.folder, self.out = forks, folder, folder / "run"
        self.again = Outcome(-1, None)

    def run(self, env: dict[str, str] | None = None, **arguments: Any) -> Outcome:
        """The job, into this folder's run."""
        return self.forks.run(env, **{"out": str(self.out), **arguments})

    def whole(self, **arguments: Any) -> dict[str, Any]:
        """The files of the same run without a fault."""
        out = self.folder / "straight" / "run"
        done = self.forks.run(out=str(out), **arguments)
        if done.code:
            raise AssertionError(done.said)
        return snapshot(out)

    def lost_after(self, wanted: dict[str, Any], **again: Any) -> tuple[str, ...]:
        """Run again (kept as ``self.again``); name every file that differs and every finished cell that was redone."""
        lost = [f"{name} is half written" for name in half_written(self.out)]
        before = finished_cells(self.out, sound=True)
        done = self.again = self.run(**again)
        if done.code:
            return (*lost, f"the second run failed: {done.said[-400:]}")
        files = snapshot(self.out)
        names = sorted(wanted.keys() | files.keys())
        lost += [f"{name} differs" for name in names if wanted.get(name) != files.get(name)]
        calls = done.answer["calls"]
        lost += [f"{method} ran again on {scene}" for method, scene in before if calls.get(f"run {method} {scene}")]
        return tuple(lost)

    def run_again(self) -> str:
        """Which methods the second run called, in words."""
        calls = sorted(call[4:] for call in self.again.answer["calls"] if call.startswith("run "))
        return f"the second run calls {' and '.join(calls) or 'no method'}"


def ended(done: Outcome) -> str:
    """How a job ended, in words: by itself, by a signal, by an error (its kind, and what the system said)."""
    if done.code == 0:
        failed = [" ".join(cell) for cell in done.answer["failed"]]
        return f"the run finishes, {', '.join(failed) or 'nothing'} failed"
    if done.code < 0:
        return f"killed by signal {-done.code}"
    errors = re.findall(r"^orca\.errors\.(\w+): (.*)$", done.said, re.MULTILINE)
    if not errors:
        return f"the run ends with exit code {done.code}"
    kind, given = errors[-1]
    reason = re.search(r"\(([^()]*)\)$", given)
    return f"the run ends: {kind}" + (f" ({reason[1]})" if reason else "")


def records(out: Path) -> list[CellRecord]:
    """Every result that has its name, by method and scene."""
    paths = sorted(path for path in out.glob("scenes/*/*.json") if not path.name.startswith("."))
    return [CellRecord.from_json(json.loads(path.read_text()), str(path)) for path in paths]


def recorded(out: Path) -> str:
    """What the results say of failures, in words, and how many have none."""
    failures: dict[str, list[str]] = defaultdict(list)
    for record in records(out):
        cell = f"{record.method} {record.scene}"
        if record.failure is not None:
            failures[f"{record.failure.kind} in {record.failure.phase}"].append(cell)
        broken = [(key, str(score.reason)) for key, score in record.scores.items() if score.status == FAILED]
        for kind in dict.fromkeys(reason.partition(":")[0] for _, reason in broken):
            names = ", ".join(key for key, reason in broken if reason.startswith(f"{kind}:"))
            failures[f"{kind} of {names}"].append(cell)
    words = [f"{what} recorded for {' and '.join(cells)}" for what, cells in failures.items()]
    whole = len(finished_cells(out, sound=True))
    return "; ".join([*(words or ["no failure recorded"]), f"{whole} results whole"])
