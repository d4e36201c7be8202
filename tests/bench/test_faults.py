"""Each fault of the table in docs/faults.md: injected, and nothing is lost."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.faults.__main__ import DOCS, OPEN
from tests.faults.forks import Forks
from tests.faults.scenarios import SCENARIOS, VARIES
from tests.faults.workbench import Workbench


@pytest.fixture(scope="module")
def bench() -> Iterator[Forks]:
    with Forks("tests.faults.jobs:bench_job") as forks:
        yield forks


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in SCENARIOS if name != "kill -9 at every write point of a run"])
def test_nothing_is_lost(bench: Forks, tmp_path: Path, name: str) -> None:
    """(What is left out here is test_faults_kill.py.)"""
    try:
        told = SCENARIOS[name](Workbench(bench, tmp_path))
    except PermissionError as error:
        pytest.skip(str(error))
    assert told.lost == ()
    if name not in VARIES:
        assert told.happened == written()[name][0], "run `python -m tests.faults` with this name"


def written() -> dict[str, tuple[str, str]]:
    """Fault -> what happened and what was lost, as docs/faults.md has it."""
    rows = [line.split(" | ") for line in DOCS.read_text(encoding="utf-8").splitlines() if line.startswith("| ")][1:]
    return {row[0].removeprefix("| "): (row[1], row[2].removesuffix(" |")) for row in rows}


def test_the_table_has_every_fault_and_no_loss() -> None:
    assert list(written()) == list(SCENARIOS)
    assert {lost for _, lost in written().values()} == {"nothing"}
    assert OPEN not in {happened for happened, _ in written().values()}
