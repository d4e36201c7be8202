"""Every fault that is injected, what happens, and what is lost: run by the tests, and written down by a script."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from orca.atomic import drop_unfinished
from orca.faults import STEPS, VARIABLE
from tests.faults.forks import Forks, Outcome
from tests.faults.snapshot import finished_cells, half_written, snapshot

__all__ = ["KINDS", "SCENARIOS", "Told", "Workbench"]

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
    """What came of a fault: in words, and what was lost (nothing, if all is well)."""

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
        """Run again; name every file that differs from an uninterrupted run's and every finished cell done again."""
        lost = [f"{name} is half written" for name in half_written(self.out)]
        before = finished_cells(self.out, sound=True)
        done = self.run(**again)
        if done.code:
            return (*lost, f"the second run failed: {done.said[-400:]}")
        files = snapshot(self.out)
        names = sorted(wanted.keys() | files.keys())
        lost += [f"{name} differs" for name in names if wanted.get(name) != files.get(name)]
        calls = done.answer["calls"]
        lost += [f"{method} ran again on {scene}" for method, scene in before if calls.get(f"run {method} {scene}")]
        return tuple(lost)


def _kills(bench: Workbench) -> Told:
    wanted, lost, count = bench.whole(), [], 0
    for kind, pattern in KINDS.items():
        for step in STEPS:
            bench.out = bench.folder / f"{kind}-{step}" / "run"
            killed = bench.run({VARIABLE: f"kill {step} {pattern}"})
            lost += [] if killed.code == -signal.SIGKILL else [f"{kind} {step} was not reached"]
            lost += bench.lost_after(wanted)
            count += 1
    return Told(f"killed at {count} points: {len(KINDS)} kinds of file, {len(STEPS)} steps each", tuple(lost))


def _worker_killed(bench: Workbench) -> Told:
    """A worker dies at the third result that it writes of a scene; the second try has fewer than three left."""
    wanted = bench.whole()
    first = bench.run({VARIABLE: "kill written */scenes/light/b.json 3"}, workers=2)
    died = len(list(bench.out.glob("scenes/light/.b~*")))  # what it was writing
    ended = died == 1 and first.code == 0 and first.answer["failed"] == []
    lost = [] if ended else [f"{died} died, exit code {first.code}: {first.said[-300:]}"]
    now = snapshot(bench.out)
    lost += [f"{name} differs" for name, content in wanted.items() if now.get(name) != content]
    told = "the scene is tried once more, from its last result on; the run ends without a failure"
    return Told(told, (*lost, *bench.lost_after(wanted)))


def _no_room(bench: Workbench) -> Told:
    wanted, lost = bench.whole(), []
    for kind, pattern in KINDS.items():
        bench.out = bench.folder / kind / "run"
        full = bench.run({VARIABLE: f"ENOSPC written {pattern}"})
        lost += [] if full.code == 1 and "CannotWrite" in full.said else [f"{kind}: {full.said[-200:]}"]
        lost += bench.lost_after(wanted)
    return Told("the run ends: cannot write, make room; nothing is recorded as a failure of a method", tuple(lost))


def _full_disk(bench: Workbench) -> Told:
    wanted, disk = bench.whole(), bench.folder / "disk"
    with _tmpfs(disk, "64k"):
        bench.out = disk / "run"
        full = bench.run()
        ended = full.code == 1 and "No space left" in full.said
        done = len(finished_cells(bench.out))
        _mount("-o", "remount,size=16m", str(disk))
        lost = bench.lost_after(wanted)
    told = f"the run ends: no space left, after {done} of 4 results" if ended else full.said[-300:]
    return Told(told, lost if ended else (*lost, "it did not end"))


def _read_only(bench: Workbench) -> Told:
    wanted, disk = bench.whole(), bench.folder / "disk"
    with _tmpfs(disk, "16m"):
        bench.out = disk / "run"
        bench.run(scenes=["a"])
        _mount("-o", "remount,ro", str(disk))
        refused = bench.run()
        _mount("-o", "remount,rw", str(disk))
        lost = bench.lost_after(wanted)
    ended = refused.code == 1 and "CannotWrite" in refused.said
    return Told("the run ends before any work: cannot write", lost if ended else (*lost, refused.said[-300:]))


def _vanished(bench: Workbench) -> Told:
    from orca.images import save_image

    images = bench.folder / "images"
    for k, name in enumerate("ab"):
        save_image(images / f"{name}.png", np.full((24, 32, 3), 60 + 40 * k, np.uint8))
    arguments = {"images": str(images), "metrics": ["bright"]}
    wanted = bench.whole(**arguments)
    (images / "b.png").rename(bench.folder / "b.png")
    first = bench.run(**arguments)
    failed = sorted(first.answer["failed"]) if first.answer else first.said[-300:]
    (bench.folder / "b.png").rename(images / "b.png")
    lost = bench.lost_after(wanted, **arguments, retry_failed=True)
    ended = failed == [["dark", "b"], ["light", "b"]]
    told = "its scene is a failure of each method, typed; the other scene is finished"
    return Told(told, lost if ended else (*lost, str(failed)))


def _misbehaving(
    switch: str, how: str, kind: str, cells: list[list[str]], told: str, **arguments: Any
) -> Callable[[Workbench], Told]:
    """A step that hangs or wants too much memory: a failure of ``kind`` of these cells, the others are finished."""

    def scenario(bench: Workbench) -> Told:
        wanted = bench.whole()
        first = bench.run(switches={switch: how}, **arguments)
        lost = [] if first.code == 0 and first.answer["failed"] == cells else [f"{first.code}: {first.said[-400:]}"]
        text = "".join(path.read_text() for path in sorted(bench.out.glob("scenes/*/*.json")))
        lost += [] if kind in text else [f"no record says {kind}"]
        return Told(told, (*lost, *bench.lost_after(wanted, retry_failed=True)))

    return scenario


def _stuck(bench: Workbench) -> Told:
    """Compiled code that hears no signal: the process ends after writing down why; the next run goes on."""
    wanted = bench.whole()
    first = bench.run(switches={"bright a": "spin"}, cell_timeout=8.0)
    lost = [] if first.code == 75 else [f"exit code {first.code}, not 75"]
    second = bench.run(switches={"bright a": "spin"}, cell_timeout=8.0)  # its second method hangs as well
    third = bench.run(switches={"bright a": "spin"}, cell_timeout=8.0)
    lost += [] if (second.code, third.code) == (75, 0) else [f"exit codes {second.code}, {third.code}"]
    return Told(
        "written down as timed out; the process ends (75), the same command goes on with the next step",
        (*lost, *bench.lost_after(wanted, retry_failed=True)),
    )


_CTRL_C = """
import signal, sys
import bench.cli
from bench.commands.outcome import Outcome
from tests.faults.jobs import bench_job
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs start without it
def call(args):
    bench_job(sys.argv[1], switches={"light a": "hang"})
    return Outcome("", {}, 0)
bench.cli._call = call
sys.exit(bench.cli.main(["run"]))
"""


def _ctrl_c(times: int) -> Callable[[Workbench], Told]:
    def scenario(bench: Workbench) -> Told:
        wanted = bench.whole()
        root = Path(__file__).resolve().parents[2]
        run = subprocess.Popen(
            [sys.executable, "-c", _CTRL_C, str(bench.out)],
            cwd=root,
            env={**os.environ, "OMP_NUM_THREADS": "1"},  # as many as the other processes have: tables name them
            stderr=subprocess.PIPE,
            start_new_session=True,
        )
        end = time.monotonic() + 300
        while ("dark", "a") not in finished_cells(bench.out) or not _three_scores(bench.out):
            if time.monotonic() > end or run.poll() is not None:
                run.kill()
                return Told("it never began", ("everything",))
            time.sleep(0.05)
        for _ in range(times):
            with suppress(ProcessLookupError):
                os.kill(run.pid, signal.SIGINT)
            time.sleep(0.02)
        _, said = run.communicate()
        ended = run.returncode in (130, -signal.SIGINT)
        lost = bench.lost_after(wanted)
        told = "the run ends and says that the same command goes on from there"
        return Told(told, lost if ended else (*lost, f"exit code {run.returncode}: {said[-300:]!r}"))

    return scenario


def _three_scores(out: Path) -> bool:
    return finished_cells(out).get(("dark", "a")) == {"bright", "brightest", "covered", "only_a"}


def _torn_result(bench: Workbench) -> Told:
    """What no kill leaves, but a broken disk may: half of a result under its name."""
    wanted = bench.whole()
    bench.run()
    path = bench.out / "scenes" / "light" / "b.json"
    os.truncate(path, path.stat().st_size // 2)
    refused = bench.run()
    lost = [] if refused.code == 1 and "light/b.json" in refused.said and "BadInput" in refused.said else [refused.said]
    path.unlink()
    return Told("the run refuses the file by name; deleted, it is made again", (*lost, *bench.lost_after(wanted)))


def _torn_frames(bench: Workbench) -> Told:
    wanted = bench.whole()
    bench.run(metrics=["bright"])
    path = bench.out / "frames" / "light" / "b.npz"
    os.truncate(path, path.stat().st_size // 2)
    done = bench.run()
    again = done.answer["calls"].get("run light b", 0) if done.answer else 0
    lost = [] if again == 1 and "run dark b" not in done.answer["calls"] else [f"{done.said[-300:]}"]
    told = "a new metric finds them broken, and the method runs again on that scene only"
    return Told(told, (*lost, *bench.lost_after(wanted)))


def _torn_cache(bench: Workbench) -> Told:
    wanted = bench.whole()
    bench.run()
    for path in (bench.out / "cache" / "scores").rglob("*.json"):
        os.truncate(path, path.stat().st_size // 2)
    for path in (bench.out / "scenes").rglob("*.json"):
        document = json.loads(path.read_text())
        path.write_text(json.dumps({**document, "scores": {}}))
    done = bench.run()
    lost = [] if done.code == 0 and done.answer["calls"].get("bright") == 4 else [done.said[-300:]]
    return Told("left aside with a warning, computed again", (*lost, *bench.lost_after(wanted)))


class _tmpfs:
    """A small real disk; raises `PermissionError` where none may be mounted."""

    def __init__(self, place: Path, size: str) -> None:
        self._place, self._size = place, size

    def __enter__(self) -> None:
        self._place.mkdir(parents=True)
        _mount("-t", "tmpfs", "-o", f"size={self._size}", "tmpfs", str(self._place))

    def __exit__(self, *_: object) -> None:
        subprocess.run(["umount", str(self._place)], check=True)


def _mount(*arguments: str) -> None:
    try:
        subprocess.run(["mount", *arguments], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError) as error:
        raise PermissionError(f"no disk can be mounted here: {error}") from error


def _writers(bench: Workbench) -> Told:
    """Each kind of single file, killed at each step over an older one; `test_faults_writes` knows of no other way."""
    from tests.faults.writers import WRITERS, steps_of  # with it comes torch

    lost, count = [], 0
    with Forks("tests.faults.writers:writer_job") as forks:
        for name in WRITERS:
            straight = bench.folder / "straight" / name
            straight.parent.mkdir(exist_ok=True)
            forks.run(writer=name, out=str(straight))
            for step in steps_of(name):
                lost += _written(forks, name, bench.folder / f"{name}-{step}", step, straight.read_bytes())
                count += 1
    return Told(f"killed at {count} points of {len(WRITERS)} writers: the old file, or the new one", tuple(lost))


def _written(forks: Forks, name: str, folder: Path, step: str, wanted: bytes) -> list[str]:
    folder.mkdir()
    path, old = folder / name, b"older"
    path.write_bytes(old)
    killed = forks.run({VARIABLE: f"kill {step} *{name}"}, writer=name, out=str(path))
    now = path.read_bytes()
    if killed.code != -signal.SIGKILL or now != (wanted if step == "named" else old):
        return [f"{name}, {step}: exit code {killed.code}, {len(now)} bytes"]
    drop_unfinished(folder)
    forks.run(writer=name, out=str(path))
    left = [other.name for other in folder.iterdir() if other.name != "archive.zip"]
    if path.read_bytes() != wanted or left != [name]:
        return [f"{name}, {step}: the second run left {sorted(left)}"]
    return []


# Injected -> what it does.
SCENARIOS: dict[str, Callable[[Workbench], Told]] = {
    "kill -9 at every write point of a run": _kills,
    "kill -9 at every write point of every other writer": _writers,
    "kill -9 of a worker (`--jobs 2`) at a result": _worker_killed,
    "ENOSPC at each kind of file": _no_room,
    "a real disk of 64 kB that fills up": _full_disk,
    "a real disk that turns read-only": _read_only,
    "an image that vanishes between listing and loading": _vanished,
    "a metric that sleeps for ever (`--cell-timeout`)": _misbehaving(
        "bright a",
        "hang",
        "timed_out",
        [["dark", "a"], ["light", "a"]],
        "its scores are failures: timed out; all else is finished",
        cell_timeout=8.0,
    ),
    "a method that sleeps for ever (`--cell-timeout`)": _misbehaving(
        "dark a", "hang", "timed_out", [["dark", "a"]], "that cell is a failure: timed out", cell_timeout=8.0
    ),
    "a metric that never returns from compiled code": _stuck,
    "a method without memory": _misbehaving(
        "dark a", "memory", "out_of_memory", [["dark", "a"]], "that cell is a failure: out of memory"
    ),
    "a metric without memory": _misbehaving(
        "bright b",
        "memory",
        "out_of_memory",
        [["dark", "b"], ["light", "b"]],
        "its scores are failures: out of memory; all else is finished",
    ),
    "Ctrl-C": _ctrl_c(1),
    "Ctrl-C twice": _ctrl_c(2),
    "half of a result under its name": _torn_result,
    "half of the stored frames": _torn_frames,
    "half of each kept score": _torn_cache,
}
