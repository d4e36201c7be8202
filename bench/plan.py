"""What is left to do: decided from the records alone, so that a finished run costs nothing to start again."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bench.metrics.metric import MetricSpec
from bench.record import FAILED, UNAVAILABLE, CellRecord
from orca.errors import BadInput

__all__ = ["IDENTITY", "Work", "check_same_run", "in_order", "work_left"]

# What fixes the frames of every cell of a run; another value of one of these is another run.
IDENTITY = ("dataset", "images", "trajectory", "preset", "seed", "device", "codec")


@dataclass(frozen=True)
class Work:
    """What one cell still needs.

    Attributes:
        method: the method has to run.
        metrics: ids to compute.
        why: in words, for the log; empty when there is nothing to do.
    """

    method: bool
    metrics: tuple[str, ...]
    why: str = ""

    def __bool__(self) -> bool:
        return self.method or bool(self.metrics)


def work_left(
    record: CellRecord | None, version: str, specs: Mapping[str, MetricSpec], retry_failed: bool = False
) -> Work:
    """Compare a stored cell with what is asked for.

    Args:
        record: the stored cell, or None.
        version: the method's version today.
        specs: metric id -> spec today, for every id asked for.
        retry_failed: run failed methods, and failed or unavailable metrics, again.
    """
    everything = tuple(specs)
    if record is None:
        return Work(True, everything, "not run yet")
    if record.method_version != version:
        return Work(True, everything, f"method version was {record.method_version}, is {version}")
    if record.failure is not None:
        return Work(True, everything, "failed before") if retry_failed else Work(False, ())
    again = (FAILED, UNAVAILABLE) if retry_failed else ()
    missing = tuple(
        metric_id
        for metric_id, spec in specs.items()
        if (score := record.scores.get(metric_id)) is None or not score.made_by(spec) or score.status in again
    )
    return Work(False, missing, f"scores missing: {', '.join(missing)}" if missing else "")


def check_same_run(stored: Mapping[str, Any] | None, identity: Mapping[str, Any], out: object) -> None:
    """Refuse to mix two runs in one folder.

    Raises:
        BadInput: the folder holds a run with another data set, trajectory, preset, seed, device or codec.
    """
    if stored is None:
        return
    before = stored.get("identity", {})
    changed = [field for field in IDENTITY if before.get(field) != identity.get(field)]
    if changed:
        field = changed[0]
        raise BadInput(
            f"{out} holds a run with {_listed(changed, before)}; this one has {_listed(changed, identity)}",
            f"the same {field} as before ({before.get(field)}) in the same --out",
            "give another --out, or delete the old run",
        )


def in_order(names: Iterable[str], known: Iterable[str]) -> list[str]:
    """Each name once: those that are known in their known order, then the others by name."""
    together = set(names)
    first = [name for name in known if name in together]
    return first + sorted(together.difference(first))


def _listed(fields: Sequence[str], values: Mapping[str, Any]) -> str:
    return ", ".join(f"{field} {values.get(field)}" for field in fields)
