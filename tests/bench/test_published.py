"""The paper's numbers: consistent with one another, and printed as the paper prints them."""

from __future__ import annotations

from decimal import ROUND_HALF_UP, Decimal

import pytest

from bench.published import published_tables, read_published
from orca.errors import Unknown

METRICS = ("musiq", "clipiqa", "noise_free", "edge", "structure", "detail", "quality")


@pytest.mark.parametrize("method", ["vistadream", "orca"])
@pytest.mark.parametrize("metric", METRICS)
def test_the_mean_of_table_2_is_table_1_to_four_decimals(method: str, metric: str) -> None:
    scenes = [Decimal(row[metric]) for row in read_published(2) if row["method"] == method]
    total = next(r[metric] for r in read_published(1) if (r["dataset"], r["method"]) == ("realmdreamer", method))
    assert len(scenes) == 11
    mean = sum(scenes, Decimal(0)) / 11
    assert str(mean.quantize(Decimal("0.0001"), ROUND_HALF_UP)) == total


def test_every_published_number_is_printed_as_the_paper_writes_it() -> None:
    first, second, third = published_tables()
    for number, table in ((1, first), (2, second)):
        printed = [[cell.text for cell in row.cells] for row in table.rows]
        assert printed == [[row[metric] for metric in METRICS] for row in read_published(number)]
    assert [[cell.text for cell in row.cells] for row in third.rows] == [["0.8265", "0.9980"], ["0.9864", "1.0000"]]


def test_bold_is_the_papers() -> None:
    rows = {row.labels: row for row in published_tables()[1].rows}
    heads = [head.key for head in published_tables()[1].heads]
    bold = {labels: {k for k, cell in zip(heads, row.cells, strict=True) if cell.bold} for labels, row in rows.items()}
    assert bold["car", "VistaDream"] == {"quality"}
    assert bold["car", "Ours"] == {"musiq", "clipiqa", "noise_free", "detail"}
    assert bold["bear", "Ours"] == set(METRICS) - {"structure"}  # 0.00 against 0.00 is a tie


def test_markdown_has_arrows_and_bold() -> None:
    text = published_tables()[0].to_markdown()
    assert "| Dataset | Method | MUSIQ ↑ |" in text
    assert "|  | Ours | **68.7133** |" in text


def test_there_is_no_fourth_table() -> None:
    with pytest.raises(Unknown, match="1, 2, 3"):
        read_published(4)
