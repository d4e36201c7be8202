"""Tables: honest means, typed gaps, bold only where it is earned, and no mixing of cameras."""

from __future__ import annotations

import csv
import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from bench.measured import Measured, read_runs
from bench.runner import RunRequest, run_bench
from bench.store import RunStore, write_json
from bench.tableformat import Head, Row, Table, TableCell
from bench.tables import dataset_table, scene_table, write_tables
from orca.errors import BadInput
from tests.bench import spine_fakes as fakes
from tests.bench.spine_fakes import SWITCHES, FakeDataset


@pytest.fixture(autouse=True)
def _fresh() -> None:
    fakes.reset()


def run(out: Path, **changes: Any) -> Measured:
    request = RunRequest(FakeDataset(), ("a", "b"), ("dark", "light"), ("bright", "covered", "only_a", "learned"), out)
    run_bench(replace(request, command="bench run", **changes), methods=fakes.METHODS, metrics=fakes.METRICS)
    return read_runs([out])


def cells(table: Table, *labels: str) -> dict[str, TableCell]:
    row = next(row for row in table.rows if row.labels == labels)
    return {head.key: cell for head, cell in zip(table.heads, row.cells, strict=True)}


def test_a_complete_column_is_a_mean_and_an_incomplete_one_says_x_of_y(tmp_path: Path) -> None:
    row = cells(dataset_table(run(tmp_path)), "light")
    assert (row["bright"].text, row["bright"].value, row["bright"].scenes) == ("201.00", 201.0, "2/2")
    assert (row["only_a"].text, row["only_a"].scenes) == ("1.0 (1/2) [1]", "1/2")
    assert (row["learned"].text, row["learned"].value) == ("n/a [2]", None)
    assert row["failed"].text == "0/2"
    assert (row["seconds"].text, row["render_ms_per_frame"].text, row["anchors"].text) == ("2.0", "20.0", "100")


def test_the_notes_give_the_reasons_the_command_and_the_machine(tmp_path: Path) -> None:
    notes = dataset_table(run(tmp_path)).notes
    assert "[1] no true view in this scene" in notes
    assert any(note.startswith("[2] learned needs w.pth; get it") for note in notes)
    assert notes[0].startswith("bench run. Data set fake, preset draft, seed 0. ")
    assert " threads, cpu. 20" in notes[0]


def test_a_failed_scene_is_a_cell_and_a_count(tmp_path: Path) -> None:
    SWITCHES["dark b"] = "crash"
    measured = run(tmp_path)
    row = cells(dataset_table(measured), "dark")
    assert row["failed"].text == "1/2"
    assert row["bright"].text == "11.00 (1/2) [1]"
    assert cells(scene_table(measured), "b", "dark")["bright"].text == "fail [2]"
    reason = "crash in fit: IndexError: percentile of an empty array"
    assert f"[2] {reason}" in scene_table(measured).notes
    assert f"[1] {reason}" in dataset_table(measured).notes


def test_all_scenes_failed_is_fail_and_not_a_gap(tmp_path: Path) -> None:
    SWITCHES.update({"dark a": "crash", "dark b": "crash"})
    row = cells(dataset_table(run(tmp_path)), "dark")
    assert (row["bright"].text, row["seconds"].text, row["failed"].text) == ("fail [1]", "fail [1]", "2/2")


def test_a_failed_metric_counts_as_failed(tmp_path: Path) -> None:
    SWITCHES["bright"] = "crash"
    measured = run(tmp_path)
    assert cells(scene_table(measured), "a", "dark")["bright"].text.startswith("fail [")
    assert cells(dataset_table(measured), "dark")["failed"].text == "2/2"


def test_what_was_not_run_is_a_dash(tmp_path: Path) -> None:
    run(tmp_path, scenes=("a",), methods=("dark",))
    measured = run(tmp_path, scenes=("b",), methods=("light",))
    assert cells(scene_table(measured), "a", "light")["bright"].text == "-"
    assert cells(dataset_table(measured), "light")["bright"].text == "201.00 (1/2)"


def test_bold_is_strictly_best_as_printed(tmp_path: Path) -> None:
    table = scene_table(run(tmp_path, methods=("dark", "light", "also-dark")))
    bold = {row.labels[1]: row.cells[0].bold for row in table.rows if row.labels[0] == "a"}
    assert bold == {"dark": False, "light": True, "also-dark": False}
    assert not any(row.cells[1].bold for row in table.rows)  # covered: all equal
    assert "**201.00**" in table.to_markdown()
    table = dataset_table(run(tmp_path.with_name("ties"), methods=("dark", "also-dark")))
    assert not any(cell.bold for row in table.rows for cell in row.cells)


def test_lower_is_better_where_the_spec_says_so() -> None:
    record = Measured("d", (), (), (), {}, ())
    assert dataset_table(record).rows == ()
    from bench.measured import Column
    from bench.tables import _mark_best

    lines = [[TableCell("3.0", 3.0)], [TableCell("2.0", 2.0)], [TableCell("n/a")]]
    _mark_best(Column("niqe", "NIQE", 1, False), lines, 0)
    assert [line[0].bold for line in lines] == [False, True, False]
    alone = [[TableCell("3.0", 3.0)], [TableCell("n/a")]]
    _mark_best(Column("niqe", "NIQE", 1, False), alone, 0)
    assert not alone[0][0].bold


def test_no_bold_between_means_over_different_scenes(tmp_path: Path) -> None:
    SWITCHES["dark b"] = "crash"
    table = dataset_table(run(tmp_path))
    assert not cells(table, "light")["bright"].bold
    SWITCHES.clear()
    table = dataset_table(run(tmp_path, retry_failed=True))
    assert cells(table, "light")["bright"].bold


def test_other_cameras_do_not_share_a_table(tmp_path: Path) -> None:
    run(tmp_path / "one", methods=("dark",))
    run(tmp_path / "two", methods=("light",), dataset=FakeDataset(shift=0.1))
    with pytest.raises(BadInput, match=r"scene a: dark and light have different cameras .*first differing frame: 3"):
        read_runs([tmp_path / "one", tmp_path / "two"])


def test_other_evaluated_frames_do_not_share_a_table(tmp_path: Path) -> None:
    run(tmp_path, scenes=("a",))
    path = RunStore(tmp_path).record_path("light", "a")
    record = RunStore(tmp_path).load("light", "a")
    assert record is not None
    write_json(path, replace(record, frames=record.frames[:2]).to_json())
    with pytest.raises(BadInput, match=r"scene a: dark and light have different cameras .*other evaluated frames"):
        read_runs([tmp_path])


def test_two_variants_of_a_metric_do_not_share_a_table(tmp_path: Path) -> None:
    run(tmp_path, scenes=("a",))
    record = RunStore(tmp_path).load("light", "a")
    assert record is not None
    other = replace(record.scores["bright"], spec=record.scores["bright"].spec | {"variant": "median"})
    RunStore(tmp_path).save(replace(record, scores=record.scores | {"bright": other}))
    with pytest.raises(BadInput, match="metric bright in 2 variants: mean; median"):
        read_runs([tmp_path])


def test_mixed_versions_are_named(tmp_path: Path) -> None:
    run(tmp_path, scenes=("a",))
    SWITCHES["version"] = "2"
    measured = run(tmp_path, scenes=("b",))
    assert "mixed versions of dark: 1; 2" in measured.caption


def test_two_runs_stand_side_by_side(tmp_path: Path) -> None:
    run(tmp_path / "one")
    run(tmp_path / "two", methods=("dark",))
    measured = read_runs([tmp_path / "one", tmp_path / "two"])
    assert measured.methods == ("dark (one)", "light", "dark (two)")
    assert cells(dataset_table(measured), "dark (two)")["bright"].text == "11.00"


def test_two_data_sets_do_not_share_a_table(tmp_path: Path) -> None:
    run(tmp_path / "one")
    run(tmp_path / "two", dataset=FakeDataset(name="other"))
    with pytest.raises(BadInput, match="one data set"):
        read_runs([tmp_path / "one", tmp_path / "two"])


def test_a_folder_without_a_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="no run in"):
        read_runs([tmp_path])


def test_csv_carries_raw_numbers_and_counts(tmp_path: Path) -> None:
    run(tmp_path, scenes=("a", "b"))
    paths = write_tables(
        tmp_path / "tables", [dataset_table(read_runs([tmp_path])), scene_table(read_runs([tmp_path]))]
    )
    forms = (".md", ".tex", ".csv", ".json")
    assert [path.name for path in paths] == [name + form for name in ("dataset", "scenes") for form in forms]
    rows = list(csv.DictReader(io.StringIO((tmp_path / "tables/dataset.csv").read_text())))
    light = next(row for row in rows if row["method"] == "light")
    assert (light["bright"], light["bright_scenes"], light["learned"]) == ("201", "2/2", "")
    rows = list(csv.DictReader(io.StringIO((tmp_path / "tables/scenes.csv").read_text())))
    assert [(row["scene"], row["method"]) for row in rows] == [(s, m) for s in "ab" for m in ("dark", "light")]
    assert rows[0]["covered"] == f"{77 / 255:.6f}"  # 0.3 in the 1/255 steps in which coverage is kept


def test_wide_text_breaks_into_blocks_that_fit_with_labels_repeated() -> None:
    heads = tuple(Head(f"m{i}", f"metric {i}") for i in range(9))
    rows = tuple(
        Row((scene, method), tuple(TableCell(f"{i}.00") for i in range(9)), method == "x")
        for scene in ("one", "two")
        for method in ("x", "y")
    )
    text = Table("t", "Title", ("Scene", "Method"), heads, rows, ("note",)).to_text(50)
    assert max(map(len, text.splitlines())) <= 50
    assert text.count("Scene  Method") == 3
    assert all(f"metric {i}" in text for i in range(9))
    lines = text.splitlines()
    assert lines[0] == "Title"
    assert lines[4].split() == ["one", "x", "0.00", "1.00", "2.00"]
    assert lines[5].split() == ["y", "0.00", "1.00", "2.00"]


def test_json_carries_value_count_and_interval(tmp_path: Path) -> None:
    document = dataset_table(run(tmp_path)).to_json()
    light = next(row for row in document["rows"] if row["method"] == "light")
    want = {"value": 201.0, "text": "201.00", "bold": True, "scenes": "2/2", "interval95": [201.0, 201.0]}
    assert light["cells"]["bright"] == want
