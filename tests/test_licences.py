"""The table of licences: every direct dependency is in it, as its installed package says today."""

from __future__ import annotations

import pytest

from tests.licences import DOCS, direct_dependencies, licence_of, weights


def written() -> dict[str, list[str]]:
    table = DOCS.read_text(encoding="utf-8").split("## Downloads", maxsplit=1)[0]
    lines = [line for line in table.splitlines() if line.startswith("| ")][1:]
    return {cells[0]: cells[1:] for cells in ([cell.strip() for cell in line.strip("|").split("|")] for line in lines)}


def test_every_direct_dependency_is_in_the_table_and_no_other() -> None:
    assert set(written()) == set(direct_dependencies()), "run `python -m tests.licences`"


@pytest.mark.parametrize("package", direct_dependencies())
def test_its_licence_is_the_one_that_the_package_states(package: str) -> None:
    now = licence_of(package)
    if now == "not installed here":
        pytest.skip(f"{package} is not installed")
    assert now != "not stated"
    assert written()[package][1] == now, "run `python -m tests.licences`"


def test_what_is_not_free_for_every_use_is_said() -> None:
    assert "non-commercial" in written()["pyiqa"][2]
    for package, (_, licence, note) in written().items():
        assert note or not any(word in licence for word in ("GPL", "General Public", "Noncommercial")), package


def test_what_is_downloaded_is_written_down_with_its_hash() -> None:
    table = DOCS.read_text(encoding="utf-8").split("## Downloads", maxsplit=1)[1]
    assert [line for line in table.splitlines() if line.startswith("| `")] == weights(), (
        "run `python -m tests.licences`"
    )
