"""What ORCA did to a scene, for the page: its repair ledger where the run kept it, else what the record says."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bench.record import CellRecord
from bench.store import read_json
from orca.errors import OrcaError

__all__ = ["read_ledger"]

_ROW_KEYS = ("iteration", "view", "area", "decision", "reason", "anchors_added", "coverage_before", "coverage_after")


def read_ledger(root: Path, record: CellRecord) -> dict[str, Any] | None:
    """Anchors by stage, and the repairs (None where the run kept no ``work/<method>/<scene>/ledger.json``).

    Returns None for a method that has neither.
    """
    stages = record.model.get("anchors_by_stage")
    repairs = _repairs(Path(root) / "work" / record.method / record.scene / "ledger.json")
    if not isinstance(stages, dict) and repairs is None:
        return None
    return {
        "stages": stages if isinstance(stages, dict) else {},
        "count": record.model.get("repairs"),
        "stopped": record.model.get("repair_stopped"),
        "repairs": repairs,
    }


def _repairs(path: Path) -> list[dict[str, Any]] | None:
    if not path.is_file():
        return None
    try:
        rows = read_json(path).get("repairs")
    except OrcaError:
        return None  # the page says that there is no ledger; `bench verify` is who complains of damage
    if not isinstance(rows, list):
        return None
    return [{key: row.get(key) for key in _ROW_KEYS} for row in rows if isinstance(row, dict)]
