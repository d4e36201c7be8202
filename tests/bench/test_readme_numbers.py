"""README, "Numbers you should get": the cheap tables are made again by their own commands and must be what it says.

A checked block is the comment ``<!-- checked -->``, a fenced block of ``python -m bench ...`` commands, and the table
that the last of them prints as Markdown (what else it prints, notes and titles, is not compared).
"""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from bench.cli import main

REPO = Path(__file__).parents[2]
BLOCK = re.compile(r"<!-- checked -->\s*```[a-z]*\n(?P<commands>.*?)```\s*\n(?P<table>(?:\|[^\n]*\n)+)", re.S)


def checked_blocks(readme: str) -> list[tuple[list[list[str]], list[str]]]:
    """The commands and the table's lines of every checked block."""
    found = []
    for match in BLOCK.finditer(readme):
        commands = [shlex.split(line.removeprefix("$ ")) for line in match["commands"].strip().splitlines()]
        assert all(words[:3] == ["python", "-m", "bench"] for words in commands), commands
        found.append(([words[3:] for words in commands], match["table"].strip().splitlines()))
    return found


def table_lines(printed: str) -> list[str]:
    return [line for line in printed.splitlines() if line.startswith("|")]


BLOCKS = checked_blocks((REPO / "README.md").read_text())


def test_the_readme_has_numbers_to_check() -> None:
    section = (REPO / "README.md").read_text().partition("## Numbers you should get")[2].partition("\n## ")[0]
    assert section.count("<!-- checked -->") == len(BLOCKS) >= 2, "a checked block is missing or not well formed"


@pytest.mark.slow
@pytest.mark.parametrize("number", range(len(BLOCKS)))
def test_the_readme_says_what_the_command_prints(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    commands, table = BLOCKS[number]
    (tmp_path / "reports").symlink_to(REPO / "reports")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("ORCA_DATA_ROOT", raising=False)
    for argv in commands:
        capsys.readouterr()
        assert main(argv) == 0, argv
    assert table_lines(capsys.readouterr().out) == table


def test_a_block_is_found_and_read() -> None:
    text = "x\n<!-- checked -->\n```\n$ python -m bench a 'b c'\npython -m bench d\n```\n\n| A |\n|---|\n| 1 |\n\nend\n"
    assert checked_blocks(text) == [([["a", "b c"], ["d"]], ["| A |", "|---|", "| 1 |"])]
    assert checked_blocks(text.replace("<!-- checked -->", "")) == []
