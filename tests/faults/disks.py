"""Disks that are full, read-only, or not ours to write; and files that are gone, or torn by something else than us."""

from __future__ import annotations

import json
import os
import subprocess
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np

from orca.faults import VARIABLE
from tests.faults.snapshot import finished_cells
from tests.faults.workbench import KINDS, Told, Workbench, ended, recorded, records

__all__ = ["full_disk", "no_right", "read_only", "refused", "torn_cache", "torn_frames", "torn_result", "vanished"]


def refused(error: str, *steps: str) -> Callable[[Workbench], Told]:
    """Writing fails with an errno, at these steps of each kind of file."""

    def scenario(bench: Workbench) -> Told:
        wanted, lost, seen, failures = bench.whole(), [], Counter[str](), 0
        for kind, pattern in KINDS.items():
            for step in steps:
                bench.out = bench.folder / f"{kind}-{step}" / "run"
                struck = bench.run({VARIABLE: f"{error} {step} {pattern}"})
                seen[ended(struck)] += 1
                failures += sum(record.any_failed for record in records(bench.out))
                lost += [] if struck.code == 1 and "CannotWrite" in struck.said else [f"{kind}: {struck.said[-200:]}"]
                lost += bench.lost_after(wanted)
        lost += [f"{failures} failures of methods were recorded"] if failures else []
        words = "; ".join(f"{count} of {len(KINDS) * len(steps)} times {how}" for how, count in seen.items())
        return Told(f"{words}; {failures} failures of a method recorded", tuple(lost))

    return scenario


def full_disk(bench: Workbench) -> Told:
    """A disk of 64 kB, made larger for the second run."""
    wanted, disk = bench.whole(), bench.folder / "disk"
    with _tmpfs(disk, "64k"):
        bench.out = disk / "run"
        full = bench.run()
        words = f"{ended(full)}; {recorded(bench.out)}"
        _mount("-o", "remount,size=16m", str(disk))
        lost = bench.lost_after(wanted)
    fine = full.code == 1 and "No space left" in full.said
    return Told(words, lost if fine else (*lost, f"it did not end: {full.said[-300:]}"))


def read_only(bench: Workbench) -> Told:
    """A disk that is mounted read-only between two runs."""
    wanted, disk = bench.whole(), bench.folder / "disk"
    with _tmpfs(disk, "16m"):
        bench.out = disk / "run"
        bench.run(scenes=["a"])
        _mount("-o", "remount,ro", str(disk))
        words, lost = _without_writing(bench)
        _mount("-o", "remount,rw", str(disk))
        lost += bench.lost_after(wanted)
    return Told(words, tuple(lost))


def no_right(bench: Workbench) -> Told:
    """Folders without the right to write (chmod), for a process that has to heed it, which root need not."""
    wanted = bench.whole()
    bench.run(scenes=["a"])
    folders = [bench.out, *(path for path in bench.out.rglob("*") if path.is_dir())]
    for folder in folders:
        folder.chmod(0o555)
    words, lost = _without_writing(bench)
    for folder in folders:
        folder.chmod(0o755)
    return Told(words, (*lost, *bench.lost_after(wanted)))


def _without_writing(bench: Workbench) -> tuple[str, list[str]]:
    """Run where nothing can be written: how that ended, and whether anything was done before."""
    before = finished_cells(bench.out)
    done = bench.run(as_anybody=True)
    new = len(finished_cells(bench.out)) - len(before)
    fine = done.code == 1 and "CannotWrite" in done.said and new == 0
    return f"{ended(done)}, with {len(before)} results from before and {new} new ones", [] if fine else [
        done.said[-300:]
    ]


def vanished(bench: Workbench) -> Told:
    """An image that is gone when its scene is loaded, and there again later."""
    from orca.images import save_image

    images = bench.folder / "images"
    for k, name in enumerate("ab"):
        save_image(images / f"{name}.png", np.full((24, 32, 3), 60 + 40 * k, np.uint8))
    arguments = {"images": str(images), "metrics": ["bright"]}
    wanted = bench.whole(**arguments)
    (images / "b.png").rename(bench.folder / "b.png")
    first = bench.run(**arguments)
    words = recorded(bench.out)
    (bench.folder / "b.png").rename(images / "b.png")
    lost = bench.lost_after(wanted, **arguments, retry_failed=True)
    failed = sorted(first.answer["failed"]) if first.answer else first.said[-300:]
    return Told(words, lost if failed == [["dark", "b"], ["light", "b"]] else (*lost, str(failed)))


def torn_result(bench: Workbench) -> Told:
    """What no kill leaves, but a broken disk may: half of a result under its name."""
    wanted = bench.whole()
    bench.run()
    path = bench.out / "scenes" / "light" / "b.json"
    os.truncate(path, path.stat().st_size // 2)
    refusal = bench.run()
    named = "light/b.json" in refusal.said
    lost = [] if refusal.code == 1 and named and "BadInput" in refusal.said else [refusal.said]
    path.unlink()
    lost += bench.lost_after(wanted)
    kind = ended(refusal).partition(" (")[0]
    words = f"{kind}, {'' if named else 'not '}naming light/b.json; once that is deleted {bench.run_again()}"
    return Told(words, tuple(lost))


def torn_frames(bench: Workbench) -> Told:
    """Half of the stored frames of one cell, found when a metric is added."""
    wanted = bench.whole()
    bench.run(metrics=["bright"])
    path = bench.out / "frames" / "light" / "b.npz"
    os.truncate(path, path.stat().st_size // 2)
    again = bench.run()
    warned = [line for line in again.answer["warnings"] if "light/b.npz" in line] if again.answer else []
    bench.again = again
    words = f"{len(warned)} warning, naming light/b.npz; {bench.run_again()}"
    calls = again.answer["calls"] if again.answer else {}
    fine = calls.get("run light b") == 1 and sum(call.startswith("run ") for call in calls) == 1 and len(warned) == 1
    return Told(words, (*([] if fine else [again.said[-300:]]), *bench.lost_after(wanted)))


def torn_cache(bench: Workbench) -> Told:
    """Half of every kept score, when the scores are wanted again."""
    wanted = bench.whole()
    bench.run()
    kept = list((bench.out / "cache" / "scores").rglob("*.json"))
    for path in kept:
        os.truncate(path, path.stat().st_size // 2)
    for path in (bench.out / "scenes").rglob("*.json"):
        document = json.loads(path.read_text())
        path.write_text(json.dumps({**document, "scores": {}}))
    done = bench.run()
    answer = done.answer or {"warnings": [], "calls": {}}
    aside = sum("left aside" in line for line in answer["warnings"])
    fine = done.code == 0 and answer["calls"].get("bright") == 4 and aside == len(kept)
    lost = [] if fine else [f"{aside} of {len(kept)} left aside: {done.said[-300:]}"]
    words = (
        f"{aside} of {len(kept)} left aside with a warning; bright computed {answer['calls'].get('bright', 0)} times"
    )
    return Told(words, (*lost, *bench.lost_after(wanted)))


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
