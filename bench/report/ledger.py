"""What ORCA did to a scene, for the page: its repair ledger where the run kept it, else what the record says."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bench.datasets import SceneCase
from bench.record import CellRecord
from bench.store import read_json
from orca.conventions import UInt8Array
from orca.errors import OrcaError

__all__ = ["draw_ledger", "read_ledger"]

_PICTURE = {"views": 2, "width": 240}  # rows, and pixels of each of the three panels in a row
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


def draw_ledger(root: Path, record: CellRecord, case: SceneCase) -> UInt8Array | None:
    """What was missing, who decided, and the view afterwards (`orca.ledger_picture`), [h, w, 3] uint8.

    Returns None for a method that repaired nothing, or where the run did not keep the scene and its ledger.

    Raises:
        OrcaError: a scene or a ledger that cannot be read, or that is not of this case's cameras.
    """
    folder = Path(root) / "work" / record.method / record.scene
    scene_file, ledger_file = folder / "scene.safetensors", folder / "ledger.json"
    if not (scene_file.is_file() and ledger_file.is_file()):
        return None
    from orca.ledger_picture import ledger_picture
    from orca.repair.ledger import Ledger
    from orca.scene import Scene

    document = read_json(ledger_file)
    if not document.get("repairs"):
        return None
    cameras = (*case.eval_trajectory.cameras(), *(view.camera for view in case.true_views))
    return ledger_picture(Scene.load(scene_file), cameras, Ledger.from_json(document), **_PICTURE)


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
