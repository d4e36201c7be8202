"""Runs made of numbers alone, for the tests of charts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from bench.metrics import MetricSpec, Score
from bench.record import CellRecord, Failure, ScoreRecord
from bench.store import RunStore

SPECS = {
    "input_psnr": MetricSpec("input_psnr", "PSNR, input view (dB)", True, (0, None), "all pixels", "1", 2),
    "niqe": MetricSpec("niqe", "NIQE", False, (0, None), "usual", "1", 3),
}


@dataclass(frozen=True)
class Cell:
    """One method on one scene: scores (None: does not apply), seconds (None: frames were read) and so on."""

    psnr: float | None = None
    niqe: float | None = None
    seconds: float | None = None
    megabytes: float | None = None
    memory: float | None = None
    notes: tuple[str, ...] = ()
    fails: bool = False
    specs: Mapping[str, MetricSpec] = field(default_factory=lambda: SPECS)

    def record(self, method: str, scene: str, dataset: str) -> CellRecord:
        cell = CellRecord(dataset, scene, method, "version 1", "0" * 64)
        if self.fails:
            return replace(cell, failure=Failure.of(IndexError("percentile of an empty array"), "method"))
        values = {"input_psnr": self.psnr, "niqe": self.niqe}
        scores = {key: ScoreRecord.of(_score(value), SPECS[key]) for key, value in values.items()}
        timing: dict[str, Any] = {"phases": {}, "render_ms_per_frame": None}
        if self.seconds is not None:
            phases = {"fit": 0.75 * self.seconds, "render": 0.25 * self.seconds}
            timing = {"phases": phases, "render_ms_per_frame": 10 * self.seconds}
        if self.memory is not None:
            timing["memory"] = {"before_mb": 500.0, "peak_mb": 500.0 + self.memory}
        model = {} if self.megabytes is None else {"bytes": 1e6 * self.megabytes}
        return replace(cell, scores=scores, timing=timing, model=model, notes=self.notes)


def _score(value: float | None) -> Score:
    return Score(None, 0, "does not apply") if value is None else Score(value, 1)


def write_cells(root: Path, cells: Mapping[str, Mapping[str, Cell]], dataset: str = "fake") -> Path:
    """Write a run of method -> scene -> cell; return its folder."""
    store = RunStore(root)
    scenes = list(dict.fromkeys(scene for row in cells.values() for scene in row))
    for method, row in cells.items():
        for scene, cell in row.items():
            store.save(cell.record(method, scene, dataset))
    store.save_run(
        {
            "schema_version": 2,
            "identity": dict.fromkeys(("images", "trajectory", "codec"))
            | {"dataset": dataset, "preset": "draft", "seed": 0, "device": "cpu"},
            "scenes": scenes,
            "methods": list(cells),
            "metrics": list(SPECS),
            "method_versions": dict.fromkeys(cells, "version 1"),
            "metric_specs": {key: spec.__dict__ for key, spec in SPECS.items()},
            "commands": ["python -m bench sweep"],
            "timing": {"started": "2026-01-02T03:04:05+00:00"},
            "host": {"cpu": "a processor", "cores": 2, "threads": 2, "versions": {}},
        }
    )
    return root


def two_scenes() -> dict[str, dict[str, Cell]]:
    """Costs 1, 2, 4 and a published method; PSNR 20, 30, 25 and 24: the third is beaten by the second."""
    return {
        "warp": {"a": Cell(19, 8, 1, 2, 100), "b": Cell(21, 9, 1, 2, 100)},
        "orca": {"a": Cell(29, 5, 2, 10, 300), "b": Cell(31, 6, 2, 10, 300)},
        "orca@anchors=16384": {"a": Cell(24, 7, 3, 5, 200), "b": Cell(26, 7, 5, 5, 200)},
        "vistadream": {"a": Cell(23, 3), "b": Cell(25, 4)},
    }
