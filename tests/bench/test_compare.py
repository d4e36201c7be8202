"""Two runs side by side: what moved, what counts as worse, and the exit code."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.cli import main
from bench.compare import Comparison, Thresholds, compare_runs, parse_thresholds
from bench.measured import Column, Measured
from bench.pairs import pairs_table
from bench.record import FAILED, CellRecord, Failure, ScoreRecord, StoredFrame
from bench.store import RunStore
from bench.tableformat import TableCell
from orca.errors import BadInput, Unknown

SCENES = tuple(f"s{i:02d}" for i in range(12))
PSNR = Column("psnr", "PSNR", 2, True, "v")
NIQE = Column("niqe", "NIQE", 3, False, "v")


def record(scene: str, method: str, values: dict[str, float | None], **changes: Any) -> CellRecord:
    scores = {
        key: ScoreRecord(v, 1, None if v is not None else "broke", "ok" if v is not None else FAILED, {"variant": "v"})
        for key, v in values.items()
    }
    timing = {"phases": {"fit": 2.0}}
    one = CellRecord("d", scene, method, "1", "ab", scores, (StoredFrame(0, "p"),), timing=timing)
    return replace(one, **changes)


def measured(values: dict[str, list[float]], columns: tuple[Column, ...] = (PSNR,), key: str = "psnr") -> Measured:
    """Method -> score of each scene."""
    records = {(m, s): record(s, m, {key: v}) for m, row in values.items() for s, v in zip(SCENES, row)}
    return Measured("d", SCENES[: len(next(iter(values.values())))], tuple(values), columns, records, ())


def noisy(shift: float, spread: float = 0.3, n: int = 12) -> list[float]:
    return list(30 + shift + spread * np.random.default_rng(int(shift * 100) + 1).standard_normal(n))


def verdicts(comparison: Comparison) -> dict[str, str]:
    return {f"{m.method} {m.column.key}": m.verdict for m in comparison.moves}


BASE = noisy(0)


@pytest.mark.parametrize(
    ("values", "verdict"),
    [
        (BASE, "same"),
        ([x + d for x, d in zip(BASE, noisy(0, 0.5, 12), strict=True)], "better"),
        ([x + (0.5 if i % 2 else -0.5) for i, x in enumerate(BASE)], "within the interval"),
        ([x - 0.1 for x in BASE], "worse"),
        ([x - 1.0 for x in BASE], "REGRESSION"),
    ],
)
def test_the_five_verdicts(values: list[float], verdict: str) -> None:
    found = compare_runs(measured({"orca": BASE}), measured({"orca": values}), Thresholds())
    assert verdicts(found)["orca psnr"] == verdict
    assert found.regressions == (("orca psnr",) if verdict == "REGRESSION" else ())
    assert verdicts(found)["orca seconds"] == "same"


def test_lower_is_better_where_the_column_says_so() -> None:
    a, b = (measured({"orca": v}, (NIQE,), "niqe") for v in (BASE, [x - 1 for x in BASE]))
    assert verdicts(compare_runs(a, b, Thresholds()))["orca niqe"] == "better"
    assert compare_runs(b, a, Thresholds()).regressions == ("orca niqe",)


def test_a_threshold_of_its_own_and_costs_only_when_named() -> None:
    a, b = measured({"orca": BASE}), measured({"orca": [x - 0.1 for x in BASE]})
    assert compare_runs(a, b, Thresholds(absolute={"psnr": 0.05})).regressions == ("orca psnr",)
    slow = replace(b, records={k: replace(r, timing={"phases": {"fit": 9.0}}) for k, r in b.records.items()})
    assert verdicts(compare_runs(a, slow, Thresholds()))["orca seconds"] == "worse"
    assert compare_runs(a, slow, Thresholds(absolute={"seconds": 1.0})).regressions == ("orca seconds",)


def test_one_scene_has_no_interval_and_is_judged_by_the_threshold_alone() -> None:
    a, b = measured({"orca": [30.0]}), measured({"orca": [29.0]})
    move = compare_runs(a, b, Thresholds()).moves[0]
    assert (move.test.low, move.test.p, move.verdict) == (None, None, "REGRESSION")


def test_a_lost_value_is_a_regression_and_one_that_was_not_asked_for_is_not() -> None:
    a = measured({"orca": BASE, "warp": BASE})
    crash = Failure("crash", {"given": "boom"}, "fit")
    records = dict(a.records)
    records["orca", "s00"] = record("s00", "orca", {}, failure=crash, frames=())
    records["orca", "s01"] = record("s01", "orca", {"psnr": None})
    records["orca", "s02"] = record("s02", "orca", {})
    del records["warp", "s03"]
    found = compare_runs(a, replace(a, records=records), Thresholds())
    assert found.lost == ("s00/orca/psnr", "s01/orca/psnr")
    assert found.regressions == ("lost s00/orca/psnr", "lost s01/orca/psnr")
    assert found.absent == ("s03/warp",)
    assert compare_runs(a, replace(a, methods=("orca",)), Thresholds()).absent == ("method warp",)


def test_the_table_shows_what_moved_and_states_the_threshold() -> None:
    a = measured({"orca": BASE, "warp": BASE})
    b = measured({"orca": [x - 1 for x in BASE], "warp": BASE})
    comparison = compare_runs(a, b, Thresholds(0.02, {"niqe": 0.1}))
    table = comparison.table()
    assert [row.labels for row in table.rows] == [("orca", "PSNR")]
    assert table.rows[0].cells[3].text == "-1.00"
    assert table.rows[0].cells[-1] == TableCell("REGRESSION", bold=True)
    assert "by more than 2 % of A's mean, niqe by more than 0.1" in table.notes[0]
    assert len(comparison.table(every=True).rows) == len(comparison.moves) > 1
    assert compare_runs(a, a, Thresholds()).table().to_text().startswith("A against B")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"dataset": "other"}, "runs over d and other"),
        ({"records": {("orca", "s99"): record("s99", "orca", {})}}, "without a common cell"),
        ({"columns": (replace(PSNR, variant="w"),)}, "metric psnr in two variants: v; w"),
        ({"records": {("orca", "s00"): record("s00", "orca", {}, trajectory_sha256="cd")}}, "different cameras"),
    ],
)
def test_runs_that_cannot_be_compared_are_refused(change: dict[str, Any], words: str) -> None:
    a = measured({"orca": BASE})
    with pytest.raises(BadInput, match=words):
        compare_runs(a, replace(a, **change), Thresholds())


def test_thresholds_are_read() -> None:
    assert parse_thresholds(None) == Thresholds(0.01, {})
    assert parse_thresholds(["0.02", "psnr=0.1,niqe=0"]) == Thresholds(0.02, {"psnr": 0.1, "niqe": 0.0})


@pytest.mark.parametrize("text", ["x", "psnr=", "=3", "-1", "psnr=nan", "psnr=inf", ""])
def test_a_broken_threshold_is_refused(text: str) -> None:
    with pytest.raises(BadInput, match="--threshold"):
        parse_thresholds([text])


def test_pairs_claim_a_win_only_where_interval_and_test_agree() -> None:
    run = measured({"orca": BASE, "worse": [x - 1 for x in BASE], "other": noisy(0.001, 3.0), "equal": BASE})
    table = pairs_table(run)
    found = {row.labels[1]: row.cells[-1].text for row in table.rows}
    assert found == {"worse": "orca better", "other": "no claim", "equal": "no claim"}
    few = measured({"orca": BASE[:5], "worse": [x - 1 for x in BASE[:5]]})
    row = pairs_table(few).rows[0]
    assert (row.cells[6].text, row.cells[-1].text) == ("0.0625", "no claim")  # 2/2^5: five scenes cannot show it
    assert pairs_table(run, "worse").rows[0].cells[-1].text == "orca better"
    with pytest.raises(Unknown, match="unknown method 'nobody'"):
        pairs_table(run, "nobody")


def test_the_command_exits_with_1_on_a_regression(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    spec = {"id": "psnr", "title": "PSNR", "variant": "v", "version": "1", "decimals": 2, "higher_is_better": True}
    for name, shift in (("a", 0.0), ("b", -1.0)):
        store = RunStore(tmp_path / name)
        identity = {"dataset": "d", "preset": "p", "seed": 0, "device": "cpu"}
        run = {"schema_version": 2, "identity": identity, "scenes": list(SCENES), "methods": ["orca"]}
        store.save_run({**run, "metrics": ["psnr"], "metric_specs": {"psnr": spec}})
        for scene, value in zip(SCENES, BASE, strict=True):
            score = ScoreRecord(value + shift, 1, None, "ok", spec)
            store.save(CellRecord("d", scene, "orca", "1", "ab", {"psnr": score}, (StoredFrame(0, "p"),)))
    one, two = str(tmp_path / "a"), str(tmp_path / "b")
    assert main(["compare", one, two]) == 1
    assert "1 regressions: orca psnr" in capsys.readouterr().out
    assert main(["compare", two, one]) == 0
    assert main(["compare", one, two, "--threshold", "0.1"]) == 0
    capsys.readouterr()
    assert main(["compare", one, two, "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["moves"][0]["difference"] == pytest.approx(-1)
    assert main(["compare", one, str(tmp_path / "c")]) == 2
