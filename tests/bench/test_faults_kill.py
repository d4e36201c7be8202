"""kill -9 at every write point of a bench run: nothing half written has a name, nothing finished is done again."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import pytest

from orca.faults import STEPS, VARIABLE
from tests.faults.forks import Forks
from tests.faults.jobs import METHODS, METRICS
from tests.faults.snapshot import finished_cells, half_written, snapshot
from tests.faults.workbench import KINDS

FAMILIES = {"bright": "bright", "covered": "covered"}  # metric -> what counts its calls


@pytest.fixture(scope="module")
def bench() -> Iterator[Forks]:
    with Forks("tests.faults.jobs:bench_job") as forks:
        yield forks


@pytest.fixture(scope="module")
def whole(bench: Forks, tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Counter[str]]:
    """The files of a run that nothing befell, and how often each kind of file was written."""
    out = tmp_path_factory.mktemp("whole") / "run"
    done = bench.run(out=str(out), log_points=True)
    assert done.code == 0, done.said
    written: Counter[str] = Counter()
    for step, path in done.answer["points"]:
        kinds = [kind for kind, pattern in KINDS.items() if fnmatch(path, pattern)]
        assert len(kinds) == 1, f"{path} is written and no kind of KINDS"
        written[kinds[0]] += step == "written"
    assert set(written) == set(KINDS)
    return snapshot(out), written


def sample(count: int) -> list[int]:
    """The first, one in the middle, the last."""
    return sorted({1, (count + 1) // 2, count})


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("kind", KINDS)
def test_killed_while_writing(
    bench: Forks, whole: tuple[dict[str, Any], Counter[str]], tmp_path: Path, kind: str, step: str
) -> None:
    files, written = whole
    for turn in sample(written[kind]):
        out = tmp_path / f"{turn}" / "run"
        killed = bench.run({VARIABLE: f"kill {step} {KINDS[kind]} {turn}"}, out=str(out))
        assert killed.code == -9, killed.said
        assert half_written(out) == []
        before = finished_cells(out)
        again = bench.run(out=str(out))
        assert again.code == 0, again.said
        assert snapshot(out) == files
        _check_calls(again.answer["calls"], before)


def _check_calls(calls: dict[str, int], before: dict[tuple[str, str], set[str]]) -> None:
    """The second run called what the first had not finished, and nothing else."""
    for method in METHODS:
        for scene in ("a", "b"):
            assert calls.get(f"run {method} {scene}", 0) == ((method, scene) not in before)
    for metric, counted in FAMILIES.items():
        missing = 4 - sum(metric in scores for scores in before.values())
        assert calls.get(counted, 0) <= missing
    for scene in ("a", "b"):
        whole_scene = all(set(METRICS) <= before.get((method, scene), set()) for method in METHODS)
        assert calls.get(f"load {scene}", 0) == (not whole_scene)


def test_a_long_table_that_was_not_written_again_is_noticed(bench: Forks, tmp_path: Path) -> None:
    """The last result of a second run is there, its long table is not: the third computes nothing and writes it."""
    out, straight = tmp_path / "run", tmp_path / "straight" / "run"
    assert bench.run(out=str(out), metrics=["bright"]).code == 0
    assert bench.run({VARIABLE: "kill made */scores.parquet"}, out=str(out)).code == -9
    again = bench.run(out=str(out))
    assert again.answer["calls"] == {}
    assert bench.run(out=str(straight), metrics=["bright"]).code == 0
    assert bench.run(out=str(straight)).code == 0
    assert snapshot(out) == snapshot(straight)


def test_what_a_live_process_is_writing_is_left_alone(tmp_path: Path) -> None:
    from orca.atomic import atomic_path, drop_unfinished

    with atomic_path(tmp_path / "a" / "b.json") as mine:
        mine.write_text("{}")
        assert drop_unfinished(tmp_path) == []
    assert (tmp_path / "a" / "b.json").read_text() == "{}"
