"""Measured runs in the paper's layout: its Table 2, fed in as scores, gives its Table 1 and every bold."""

from __future__ import annotations

from dataclasses import replace

import pytest

from bench.measured import Column, Measured
from bench.papertables import PAPER_METRICS, paper_tables
from bench.published import METHOD_TITLES, published_tables, read_published
from bench.record import UNAVAILABLE, CellRecord, ScoreRecord
from bench.tableformat import Row, Table


def paper_run() -> Measured:
    """The paper's per-scene numbers as if a run had measured them."""
    rows = read_published(2)
    records = {
        (METHOD_TITLES[row["method"]], row["scene"]): CellRecord(
            "realmdreamer",
            row["scene"],
            METHOD_TITLES[row["method"]],
            "1",
            "ab",
            {key: ScoreRecord(float(row[name]), 50, None, "ok", {}) for key, name in PAPER_METRICS.items()},
        )
        for row in rows
    }
    columns = tuple(Column(key, key, 3, True) for key in PAPER_METRICS)
    scenes = tuple(dict.fromkeys(row["scene"] for row in rows))
    return Measured("realmdreamer", scenes, tuple(METHOD_TITLES.values()), columns, records, ("caption",))


def shown(rows: tuple[Row, ...] | list[Row]) -> list[tuple[tuple[str, ...], list[tuple[str, bool]]]]:
    return [(row.labels, [(cell.text, cell.bold) for cell in row.cells]) for row in rows]


def test_the_scenes_of_table_2_give_table_2_bold_included() -> None:
    table = paper_tables([paper_run()])[1]
    assert shown(table.rows) == shown(published_tables()[1].rows)
    assert [head.title for head in table.heads] == [head.title for head in published_tables()[1].heads]


def test_their_means_are_the_realmdreamer_rows_of_table_1_bold_included() -> None:
    table = paper_tables([paper_run()])[0]
    want = [row for row in published_tables()[0].rows if row.labels[0] == "RealmDreamer"]
    assert shown(table.rows) == shown(want)
    assert table.rows[0].cells[0].low is not None


def test_an_incomplete_column_is_x_of_y_and_bold_goes_to_nobody() -> None:
    run = paper_run()
    key = ("Ours", "bear")
    scores = {**run.records[key].scores, "musiq": ScoreRecord(None, 0, "no weights", UNAVAILABLE, {})}
    run = replace(run, records={**run.records, key: replace(run.records[key], scores=scores)})
    ours, theirs = paper_tables([run])[0].rows[1], paper_tables([run])[0].rows[0]
    assert ours.cells[0].text.endswith(" (10/11) [1]")
    assert not ours.cells[0].bold
    assert not theirs.cells[0].bold
    assert ours.cells[1].bold


def cells(table: Table, *labels: str) -> list[str]:
    return [cell.text for row in table.rows if row.labels == labels for cell in row.cells]


def test_published_numbers_stand_in_rows_of_their_own_and_take_no_part_in_the_bold() -> None:
    run = replace(paper_run(), methods=("Ours",))
    first, second, third = paper_tables([run], published=True)
    assert cells(first, "RealmDreamer", "Ours (published)") == cells(first, "RealmDreamer", "Ours")
    assert cells(second, "car", "VistaDream (published)") == [
        "58.1490",
        "0.4131",
        "0.30",
        "0.00",
        "0.00",
        "0.88",
        "0.02",
    ]
    assert len(second.rows) == 33
    assert [row.labels[1] for row in second.rows[:3]] == ["Ours", "VistaDream (published)", "Ours (published)"]
    for table in (first, second, third):
        assert not any(cell.bold for row in table.rows for cell in row.cells)  # one measured method beats nobody
        assert table.notes[-1].startswith("Published rows are the paper's own numbers, not measured here")


def test_two_data_sets_share_table_1_and_the_tsed_table() -> None:
    run = paper_run()
    tsed = Column("tsed", "TSED", 3, True)
    scored = {
        key: replace(r, scores={"tsed": ScoreRecord(0.9 if key[0] == "Ours" else 0.8, 49, None, "ok", {})})
        for key, r in run.records.items()
    }
    run = replace(run, columns=(tsed,), records=scored)
    tables = paper_tables([replace(run, dataset="div2k"), run], published=True)
    assert [table.name for table in tables] == [
        "paper_datasets",
        "paper_div2k_scenes",
        "paper_realmdreamer_scenes",
        "paper_tsed",
    ]
    first, last = tables[0], tables[3]
    assert cells(first, "DIV2K", "Ours (published)")[0] == "68.7133"
    assert [head.title for head in last.heads] == ["VistaDream", "Ours", "VistaDream (published)", "Ours (published)"]
    assert cells(last, "DIV2K") == ["0.8000", "0.9000", "0.8265", "0.9980"]
    assert not any("published" in row.labels[1] for row in tables[1].rows)  # the paper has no scenes of DIV2K


def test_a_metric_that_was_not_run_is_a_dash() -> None:
    run = replace(paper_run(), columns=(), records={k: replace(r, scores={}) for k, r in paper_run().records.items()})
    assert set(cells(paper_tables([run])[0], "RealmDreamer", "Ours")) == {"-"}


@pytest.mark.parametrize("dataset", ["photos", "realmdreamer"])
def test_a_data_set_that_the_paper_does_not_have_gets_no_published_rows(dataset: str) -> None:
    first, second, third = paper_tables([replace(paper_run(), dataset=dataset)], published=True)
    known = dataset == "realmdreamer"
    assert len(first.rows) == (4 if known else 2)
    assert len(second.rows) == (44 if known else 22)
    assert third.rows[0].cells[-1].text == ("1.0000" if known else "-")
