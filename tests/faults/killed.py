"""Processes killed while they write."""

from __future__ import annotations

import signal
from collections import Counter
from pathlib import Path

from orca.atomic import drop_unfinished
from orca.faults import STEPS, VARIABLE
from tests.faults.forks import Forks
from tests.faults.snapshot import snapshot
from tests.faults.workbench import KINDS, Told, Workbench, ended

__all__ = ["kills", "worker_killed", "writers"]


def kills(bench: Workbench) -> Told:
    """kill -9 at every step of every kind of file, each time from nothing."""
    wanted, lost, seen = bench.whole(), [], Counter[str]()
    for kind, pattern in KINDS.items():
        for step in STEPS:
            bench.out = bench.folder / f"{kind}-{step}" / "run"
            killed = bench.run({VARIABLE: f"kill {step} {pattern}"})
            seen[ended(killed)] += 1
            lost += [] if killed.code == -signal.SIGKILL else [f"{kind} {step} was not reached"]
            lost += bench.lost_after(wanted)
    words = "; ".join(f"{count} times {how}" for how, count in seen.items())
    return Told(f"{words}: {len(KINDS)} kinds of file, {len(STEPS)} steps each", tuple(lost))


def worker_killed(bench: Workbench) -> Told:
    """A worker dies at the third result that it writes of a scene; the second try has fewer than three left."""
    wanted = bench.whole()
    first = bench.run({VARIABLE: "kill written */scenes/light/b.json 3"}, workers=2)
    died = len(list(bench.out.glob("scenes/light/.b~*")))  # what it was writing
    fine = died == 1 and first.code == 0 and first.answer["failed"] == []
    lost = [] if fine else [f"{died} died, exit code {first.code}: {first.said[-300:]}"]
    now = snapshot(bench.out)
    lost += [f"{name} differs" for name, content in wanted.items() if now.get(name) != content]
    notes = first.answer["notes"] if first.answer else []
    lost += [] if len(notes) == 1 and "tried once more" in notes[0] else [f"it said {notes}"]
    return Told(f'"{"; ".join(notes)}"; {ended(first)}', (*lost, *bench.lost_after(wanted)))


def writers(bench: Workbench) -> Told:
    """Each kind of single file, killed at each step over an older one; `test_faults_writes` knows of no other way."""
    from tests.faults.writers import WRITERS, steps_of  # with it comes torch

    lost, seen = [], Counter[str]()
    with Forks("tests.faults.writers:writer_job") as forks:
        for name in WRITERS:
            straight = bench.folder / "straight" / name
            straight.parent.mkdir(exist_ok=True)
            forks.run(writer=name, out=str(straight))
            for step in steps_of(name):
                now, wrong = _written(forks, name, bench.folder / f"{name}-{step}", step, straight.read_bytes())
                seen[now] += 1
                lost += wrong
    words = ", ".join(f"{count} times the {what}" for what, count in sorted(seen.items(), reverse=True))
    return Told(f"killed at {sum(seen.values())} points of {len(WRITERS)} writers: then there was {words}", tuple(lost))


def _written(forks: Forks, name: str, folder: Path, step: str, wanted: bytes) -> tuple[str, list[str]]:
    """Which file had the name after a kill, and what was wrong then or after a second run."""
    folder.mkdir()
    path, old = folder / name, b"older"
    path.write_bytes(old)
    killed = forks.run({VARIABLE: f"kill {step} *{name}"}, writer=name, out=str(path))
    now = path.read_bytes()
    there = {old: "old file", wanted: "new file"}.get(now, "broken file")
    if killed.code != -signal.SIGKILL or now != (wanted if step == "named" else old):
        return there, [f"{name}, {step}: {ended(killed)}, {len(now)} bytes"]
    drop_unfinished(folder)
    forks.run(writer=name, out=str(path))
    left = [other.name for other in folder.iterdir() if other.name != "archive.zip"]
    if path.read_bytes() != wanted or left != [name]:
        return there, [f"{name}, {step}: the second run left {sorted(left)}"]
    return there, []
