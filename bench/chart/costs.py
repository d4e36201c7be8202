"""What a method costs on one scene: seconds, milliseconds a frame, memory, size of the model; or why that is unknown.

A table prints the seconds that were spent here. On a chart of speed a method whose scene was fitted by somebody else
would look fast by them, so here its seconds count as not measured.
"""

from __future__ import annotations

from bench.measured import NOT_APPLICABLE, Column, Value
from bench.record import CellRecord

__all__ = ["CHART_COSTS", "COST_WORDS", "cost_value", "published_here"]

SECONDS = Column("seconds", "Seconds a scene", 1, False)
MS_PER_FRAME = Column("render_ms_per_frame", "Milliseconds a frame", 1, False)
MEMORY = Column("memory", "Peak memory added [MB]", 0, False)
BYTES = Column("bytes", "Model [MB]", 2, False)

CHART_COSTS = (SECONDS, MS_PER_FRAME, MEMORY, BYTES)
"""The x axes. "bytes" is in 1e6 bytes, as "memory" is."""

COST_WORDS = {
    "seconds": "seconds a scene",
    "render_ms_per_frame": "milliseconds a frame",
    "memory": "memory added at the peak",
    "bytes": "size of the model",
}

_ELSEWHERE = "elsewhere, which is not timed"  # what adapters of finished scenes note
_READ = "frames were read, not computed here"


def cost_value(record: CellRecord, key: str) -> Value:
    """The number of a cost of `CHART_COSTS` in one result, or the reason why there is none.

    Memory is what the process grew by while the method ran (`bench.memory`). Raises `KeyError` for another key.
    """
    if record.failure is not None:
        return Value(None, "fail", record.failure.summary)
    number, reason = {
        "seconds": _seconds,
        "render_ms_per_frame": _milliseconds,
        "memory": _memory,
        "bytes": _megabytes,
    }[key](record)
    return Value(None, NOT_APPLICABLE, reason) if number is None else Value(number)


def published_here(method: str) -> bool:
    """Whether the frames of a method are somebody's published ones, which nobody can time."""
    return method.partition(" ")[0].partition("@")[0] in ("vistadream", "vistadream-coarse")


def _seconds(record: CellRecord) -> tuple[float | None, str]:
    phases = record.timing.get("phases") or {}
    if not phases:
        return None, _READ
    if any(_ELSEWHERE in note for note in record.notes):
        return None, "fitted elsewhere"
    return float(sum(phases.values())), ""


def _milliseconds(record: CellRecord) -> tuple[float | None, str]:
    milliseconds = record.timing.get("render_ms_per_frame")
    return (None, _READ) if milliseconds is None else (float(milliseconds), "")


def _memory(record: CellRecord) -> tuple[float | None, str]:
    seconds, why = _seconds(record)
    if seconds is None:
        return None, why
    memory = record.timing.get("memory") or {}
    if memory.get("peak_mb") is None or memory.get("before_mb") is None:
        return None, "not measured on that system, or by an older version"
    return max(0.0, float(memory["peak_mb"]) - float(memory["before_mb"])), ""


def _megabytes(record: CellRecord) -> tuple[float | None, str]:
    size = record.model.get("bytes")
    return (None, "no size of a model is known") if size is None else (float(size) / 1e6, "")
