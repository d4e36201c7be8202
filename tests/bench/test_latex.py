"""LaTeX: it compiles whatever the text, and the paper's three tables come out of it cell by cell, bold by bold."""

from __future__ import annotations

import re
import subprocess
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.latex import escape, latex_document, latex_table
from bench.published import published_tables
from bench.tableformat import Head, Row, Table, TableCell
from tests.programs import need_programs

PAPER = Path(__file__).parent / "fixtures" / "paper_tables.tex"
Cell = tuple[str, bool]  # text, bold


@pytest.fixture
def tex() -> None:
    """The test compiles LaTeX and reads the PDF."""
    need_programs("pdflatex", "pdftohtml")


def tabulars(source: str) -> list[list[list[Cell]]]:
    """Rows of cells of every tabular, without headings and empty cells."""
    found = []
    for body in re.findall(r"\\begin\{tabular\}\{[^}]*\}(.*?)\\end\{tabular\}", source, re.S):
        plain = re.sub(r"\\(hline|toprule|midrule|bottomrule)|%[^\n]*", "", body)
        plain = re.sub(r"\\multirow\{\d+\}\{\*\}\{([^}]*)\}", r"\1", plain).replace("\\_", "_")
        rows = [[cell(text) for text in row.split("&") if text.strip()] for row in plain.split(r"\\") if row.strip()]
        found.append(rows[1:])
    return found


def cell(text: str) -> Cell:
    bold = re.fullmatch(r"\s*\\textbf\{(.*)\}\s*", text, re.S)
    return (bold.group(1) if bold else " ".join(text.split())), bold is not None


def compiled(source: str, folder: Path) -> Path:
    (folder / "t.tex").write_text(source)
    done = subprocess.run(
        ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "t.tex"],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        errors="replace",
    )
    assert done.returncode == 0, done.stdout[-2000:]
    assert "too large for page" not in done.stdout
    assert "Overfull" not in done.stdout
    return folder / "t.pdf"


def printed_rows(pdf: Path) -> Iterator[list[list[Cell]]]:
    """Lines of text of every page, from left to right, with the font's weight; arrows left out.

    A name that stands between its two rows (multirow, where that package is installed) opens the first of them.
    """
    done = subprocess.run(["pdftohtml", "-xml", "-i", "-stdout", str(pdf)], capture_output=True, text=True, check=True)
    bold = {f.get("id"): "CMBX" in f.get("family", "") for f in ElementTree.fromstring(done.stdout).iter("fontspec")}
    for page in ElementTree.fromstring(done.stdout).iter("page"):
        lines: dict[int, list[tuple[int, Cell]]] = {}
        for text in page.iter("text"):
            shown = "".join(text.itertext()).strip()
            if shown != "↑":
                line = lines.setdefault(int(text.get("top", 0)), [])
                line.append((int(text.get("left", 0)), (shown, bold[text.get("font")])))
        rows = [[found for _, found in sorted(lines[top])] for top in sorted(lines)]
        yield [beside + row for beside, row in with_names_between(rows)]


def with_names_between(rows: list[list[Cell]]) -> Iterator[tuple[list[Cell], list[Cell]]]:
    """Each row with the lone name that follows it, where the row after that is of as many cells as this one."""
    taken = False
    for i, row in enumerate(rows):
        following = rows[i + 1 : i + 3]
        alone = len(row) > 2 and [len(r) for r in following] == [1, len(row)]
        if not taken:
            yield (following[0] if alone else []), row
        taken = alone


def test_the_papers_source_has_the_cells_that_it_should() -> None:
    first, second, third = tabulars(PAPER.read_text())
    assert (len(first), len(second), len(third)) == (4, 22, 2)
    assert sum(bold for row in first for _, bold in row) == 14


def test_every_number_and_every_bold_is_the_papers_in_our_latex() -> None:
    ours = tabulars(latex_document(published_tables()))
    assert ours == tabulars(PAPER.read_text())


@pytest.mark.usefixtures("tex")
@pytest.mark.parametrize("package", ["multirow.sty", "none-such.sty"])  # with it or without, the document compiles
def test_every_number_and_every_bold_is_the_papers_in_the_pdf(tmp_path: Path, package: str) -> None:
    source = latex_document(published_tables())
    assert r"\IfFileExists{multirow.sty}" in source
    source = source.replace("{multirow.sty}", f"{{{package}}}")
    pages = list(printed_rows(compiled(source, tmp_path)))
    paper = tabulars(PAPER.read_text())
    assert len(pages) == 3
    for page, rows in zip(pages, paper, strict=True):
        drawn = [[(text.replace("_", " "), bold) for text, bold in row] for row in rows]  # an underscore is a rule
        assert page[2:] == drawn  # below the caption and the headings


def test_bold_and_groups_are_written_as_in_a_paper() -> None:
    text = latex_table(published_tables()[0])
    assert r"\multirow{2}{*}{DIV2K} & VistaDream & 61.6023" in text
    assert r" & Ours & \textbf{68.7133}" in text
    assert r"MUSIQ $\uparrow$" in text
    for rule in (r"\toprule", r"\midrule", r"\bottomrule"):
        assert rule in text


NASTY = 'a_b & 50% #1 $x$ {y} \\z ~ ^ < > | " -- --- [k] *s* ± × ≤ ≥ − · ° – — … żółw Ærø ß 中 \u202e 🐻'


@pytest.mark.usefixtures("tex")
def test_any_text_compiles(tmp_path: Path) -> None:
    letters = " ".join(chr(i) for i in range(0xA0, 0x250))
    rows = tuple(Row((name, "m"), (TableCell(NASTY, 1.0, bold=True),), True) for name in ("[1] x", "*", letters[:60]))
    table = Table("n_1", NASTY, ("Scene", "Method"), (Head("k", NASTY),), rows, (NASTY, letters))
    compiled(latex_document([table]), tmp_path)


@pytest.mark.usefixtures("tex")
def test_a_table_larger_than_the_page_is_shrunk_onto_it(tmp_path: Path) -> None:
    heads = tuple(Head(str(i), f"A long heading {i}") for i in range(30))
    wide = tuple(Row((f"method {j}",), tuple(TableCell("1.0000") for _ in heads)) for j in range(90))
    tall = tuple(Row(row.labels, row.cells[:2]) for row in wide)
    tables = [Table("w", "wide", ("M",), heads, wide, ("a note",) * 60), Table("t", "tall", ("M",), heads[:2], tall)]
    compiled(latex_document(tables), tmp_path)


@given(st.text(max_size=40))
def test_escaped_text_has_no_bare_special_character(text: str) -> None:
    bare = re.sub(r"\\([&%$#_{}]|[a-zA-Z]+\d*(\{\})?)|\$\\[a-z]+\$|\{[\[*]?\}", "", escape(text))
    assert not set(bare) & set("&%$#_^~\\<>|")


def test_two_hyphens_stay_two() -> None:
    assert escape("--out a-b ---") == "-{}-out a-b -{}-{}-"
