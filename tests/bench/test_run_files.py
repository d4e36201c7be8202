"""What "the same files" means in the other tests: every byte counts that is no timing and no host."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from bench.digest import sealed
from bench.runner import run_bench
from bench.store import read_json, write_json
from tests.bench.run_files import lasting
from tests.bench.worker_fakes import METHODS, METRICS, request_of

RESULT = "scenes/copy/s00000.json"


@pytest.fixture
def run(tmp_path: Path) -> Path:
    request = request_of(tmp_path, count=2)
    run_bench(request, None, METHODS, METRICS)
    return request.out


def test_every_file_is_there(run: Path) -> None:
    files = {path.relative_to(run).as_posix() for path in run.rglob("*") if path.is_file() and path.name != ".lock"}
    tables = {
        f"tables/{name}.{kind}" for name in ("dataset", "scenes", "pairs") for kind in ("md", "tex", "csv", "json")
    }
    assert lasting(run).keys() == files | tables
    assert {name.partition("/")[0] for name in files} >= {"run.json", "scores.parquet", "scenes", "frames", "cache"}


def _timing(document: dict[str, Any]) -> None:
    document["timing"]["wall_s"] = 99.0
    document["timing"]["phases"] = {"fit": 7.0}
    document["host"]["threads"] = 64


def _digits(document: dict[str, Any]) -> None:
    document["scores"]["grey"]["value"] += 1e-12


def _order(document: dict[str, Any]) -> None:
    document["scores"] = dict(reversed(document["scores"].items()))


@pytest.mark.parametrize(
    ("change", "differs"),
    [(_timing, set()), (_digits, {RESULT, "tables/dataset.json", "tables/scenes.json"}), (_order, {RESULT})],
)
def test_timing_and_host_do_not_count_and_all_else_does(
    run: Path, change: Callable[[dict[str, Any]], None], differs: set[str]
) -> None:
    before, unordered = lasting(run), lasting(run, ordered=False)
    document = read_json(run / RESULT)
    change(document)
    write_json(run / RESULT, sealed(document))
    after = lasting(run)
    assert {name for name in before if before[name] != after[name]} >= differs
    assert bool(differs) == (before != after)
    same_but_for_order = change in (_timing, _order)
    assert (lasting(run, ordered=False) == unordered) == same_but_for_order


@pytest.mark.parametrize("name", ["scores.parquet", "frames/copy/s00000.npz"])
def test_bytes_of_other_files_count(run: Path, name: str) -> None:
    before = lasting(run)
    content = bytearray((run / name).read_bytes())
    content[len(content) // 2] ^= 1
    (run / name).write_bytes(content)
    assert {key for key in before if before[key] != lasting(run)[key]} == {name}


def test_the_long_table_has_no_timing(run: Path) -> None:
    names = pq.read_schema(run / "scores.parquet").names
    assert not [name for name in names if "second" in name or "time" in name or name == "host"]


def test_another_layout_is_no_file_of_the_store(run: Path) -> None:
    path = run / RESULT
    path.write_text(json.dumps(json.loads(path.read_text())))
    with pytest.raises(AssertionError, match="laid out"):
        lasting(run)
