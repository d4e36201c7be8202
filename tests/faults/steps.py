"""Steps that never end or want more memory than there is."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from tests.faults.workbench import Told, Workbench, ended, recorded, records

__all__ = ["eats", "misbehaving", "stuck"]


def misbehaving(
    switch: str, how: str, kind: str, cells: list[list[str]], **arguments: Any
) -> Callable[[Workbench], Told]:
    """A step that hangs or wants too much memory: a failure of ``kind`` of these cells, the others are finished."""

    def scenario(bench: Workbench) -> Told:
        wanted = bench.whole()
        first = bench.run(switches={switch: how}, **arguments)
        lost = [] if first.code == 0 and first.answer["failed"] == cells else [f"{first.code}: {first.said[-400:]}"]
        words = recorded(bench.out)
        lost += [] if f"{kind} " in words else [f"no record says {kind}"]
        return Told(words, (*lost, *bench.lost_after(wanted, retry_failed=True)))

    return scenario


def eats(workers: int) -> Callable[[Workbench], Told]:
    """A method that takes memory until the system refuses (RLIMIT_AS), in one process or in a worker."""

    def scenario(bench: Workbench) -> Told:
        wanted = bench.whole()
        first = bench.run(switches={"light a": "eat"}, workers=workers)
        fine = first.code == 0 and first.answer["failed"] == [["light", "a"]]
        lost = [] if fine else [f"{first.code}: {first.said[-400:]}"]
        failure = next((r.failure for r in records(bench.out) if (r.method, r.scene) == ("light", "a")), None)
        given = failure.message["given"] if failure else "nothing"
        lost += [] if failure is not None and failure.kind == "out_of_memory" else [f"the record says {given}"]
        notes = first.answer["notes"] if first.answer else []
        lost += [f"a worker was lost: {notes}"] if notes else []
        words = f'{recorded(bench.out)} ("{given.partition(" for an array")[0]}"); {len(notes)} processes lost'
        lost += bench.lost_after(wanted, retry_failed=True, workers=workers)
        computed = bench.again.answer["computed"] if bench.again.answer else 0
        lost += [] if computed == 1 else [f"{computed} cells computed again"]
        return Told(f"{words}; the second run computes {computed}", tuple(lost))

    return scenario


def stuck(bench: Workbench) -> Told:
    """Compiled code that hears no signal: the process ends after writing down why; the next run goes on."""
    wanted = bench.whole()
    runs, words = [], []
    for _ in range(3):  # its second method hangs as well
        runs.append(bench.run(switches={"bright a": "spin"}, cell_timeout=8.0))
        words.append(ended(runs[-1]))
    codes = tuple(run.code for run in runs)
    lost = [] if codes == (75, 75, 0) else [f"exit codes {codes}"]
    told = f"{'; again: '.join(words)}; {recorded(bench.out)}"
    return Told(told, (*lost, *bench.lost_after(wanted, retry_failed=True)))
