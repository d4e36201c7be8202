"""The TSED tables of a run: pooled and per scene, intervals, nulls, grid, the warning, and what is missing."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from bench.cli import main
from bench.measured import Column, Measured
from bench.metrics.tsed import EpipolarSelfConsistency, Tsed, sequence_scores
from bench.metrics.tsed_config import TsedConfig
from bench.metrics.tsed_pair import PairScore
from bench.metrics.tsed_sequence import SequenceScore
from bench.record import CellRecord, ScoreRecord
from bench.tableformat import Table, TableCell
from bench.tsedtable import tsed_tables
from orca.errors import BadInput


def record(scene: str, method: str, good: int, pairs: int, frozen_good: int = 0, mode: str = "known") -> CellRecord:
    """A cell of ``pairs`` pairs at 512 px: ``good`` at 0.2 px, the others at 3 px; the null likewise."""

    def made(count: int) -> tuple[PairScore, ...]:
        return tuple(PairScore(100, 0.2 if k < count else 3.0, "F") for k in range(pairs))

    config = TsedConfig(mode=mode)  # type: ignore[arg-type]
    shifted = made(0)[1:] if mode == "known" else ()
    sequence = SequenceScore(config, 512, made(good), (7.0,) * pairs, made(frozen_good), shifted)
    specs = (Tsed() if mode == "known" else EpipolarSelfConsistency()).specs(None)
    scores = sequence_scores(sequence, 512, specs[0].id)
    return CellRecord("realmdreamer", scene, method, "1", None, {s.id: ScoreRecord.of(scores[s.id], s) for s in specs})


def measured(*records: CellRecord, dataset: str = "realmdreamer") -> Measured:
    scenes, methods = (tuple(dict.fromkeys(getattr(r, key) for r in records)) for key in ("scene", "method"))
    columns = (Column("tsed", "TSED", 3, True, "known cameras"),)
    return Measured(dataset, scenes, methods, columns, {(r.method, r.scene): r for r in records}, ("a caption",))


def cells(table: Table, *labels: str) -> dict[str, TableCell]:
    row = next(row for row in table.rows if row.labels == labels)
    return {head.key: cell for head, cell in zip(table.heads, row.cells, strict=True)}


RUN = (
    record("car", "orca", 49, 49, 10),
    record("bear", "orca", 10, 20, 10),
    record("car", "vistadream", 48, 49, 48),
    record("bear", "vistadream", 20, 20, 0),
)


def test_pooled_and_mean_of_scenes_differ_and_carry_an_interval() -> None:
    row = cells(tsed_tables(measured(*RUN))[0], "orca")
    assert row["pooled"].value == pytest.approx(59 / 69)
    assert row["pairs"].text == "59/69"
    assert row["mean"].value == 0.75
    assert row["pooled"].low is not None
    assert row["pooled"].high is not None
    assert row["pooled"].low < 59 / 69 < row["pooled"].high
    assert row["frozen_null"].value == pytest.approx((10 / 49 + 10 / 20) / 2)
    assert row["median_flow"].text == "7.0"


def test_scenes_without_power_are_counted_and_named() -> None:
    methods, scenes, _ = tsed_tables(measured(*RUN))
    assert cells(methods, "orca")["no_power"].text == "1/2"  # bear: 0.5 against a null of 0.5
    assert cells(methods, "vistadream")["no_power"].text == "1/2"
    assert "no power at this step size" in cells(scenes, "car", "vistadream")["warning"].text
    assert cells(scenes, "car", "orca")["warning"].text == ""
    assert any("no power at this step size" in note for note in methods.notes)


def test_the_grid_pools_at_every_threshold_and_both_widths() -> None:
    grid = tsed_tables(measured(*RUN))[2]
    assert len(grid.rows) == 16
    assert cells(grid, "native", "2", "10")["orca"].value == pytest.approx(59 / 69)
    assert cells(grid, "native", "4", "10")["orca"].value == 1.0  # 3 px is under 4
    assert cells(grid, "256", "2", "10")["orca"].value == 1.0  # 3 px at 512 is 1.5 at 256
    assert cells(grid, "256", "1", "15")["orca"].value == pytest.approx(59 / 69)


def test_the_row_nearest_to_the_paper_is_named() -> None:
    """The paper: VistaDream 0.9864, ORCA 1.0000. At 4 px both are 1: 0.0068 away; at 2 px ORCA is far off."""
    note = tsed_tables(measured(*RUN))[2].notes[0]
    assert "nearest row: width native, 4 px, 10 matches, 0.0068 away on average" in note
    assert "(6 rows are as near)" in note
    assert tsed_tables(measured(*RUN, dataset="photos"))[2].notes == ()


def test_the_two_modes_never_share_a_table() -> None:
    both = (*RUN, record("car", "frames", 30, 49, mode="estimated"))
    tables = tsed_tables(measured(*both))
    assert [table.name for table in tables] == [
        "tsed",
        "tsed_scenes",
        "tsed_grid",
        "epipolar_self_consistency",
        "epipolar_self_consistency_scenes",
        "epipolar_self_consistency_grid",
    ]
    assert cells(tables[0], "frames")["pooled"].text == "-"
    assert cells(tables[3], "frames")["pooled"].value == pytest.approx(30 / 49)
    assert cells(tables[3], "frames")["mean"].text.endswith("(1/2)")
    assert cells(tables[3], "frames")["shifted_camera_null"].text == "-"
    assert cells(tables[3], "orca")["pooled"].text == "-"
    assert tables[5].notes == ()


def test_tables_are_printable() -> None:
    for table in tsed_tables(measured(*RUN)):
        assert table.title in table.to_text()
        assert table.to_markdown()
        json.dumps(table.to_json(), allow_nan=False)


def test_a_run_without_tsed_is_refused() -> None:
    empty = CellRecord("realmdreamer", "car", "orca", "1", None)
    with pytest.raises(BadInput, match="without TSED"):
        tsed_tables(measured(empty))


def test_the_verb_refuses_a_folder_that_is_no_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["tsed", str(tmp_path)]) == 2
    assert "error:" in capsys.readouterr().err


def test_the_verb_prints_and_writes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def read(roots: Any) -> Measured:
        return measured(*RUN)

    monkeypatch.setattr("bench.measured.read_runs", read)
    assert main(["tsed", str(tmp_path), "--write", str(tmp_path / "tables"), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert list(document["tables"]) == ["tsed", "tsed_scenes", "tsed_grid"]
    assert (tmp_path / "tables/tsed_grid.md").is_file()
