"""Measurements of these scripts in reports/: each between two marks of one file, the words around them kept."""

from __future__ import annotations

from pathlib import Path

__all__ = ["REPORT", "put_block"]

REPORT = Path(__file__).resolve().parents[1] / "reports" / "scale" / "README.md"


def put_block(path: Path, name: str, lines: list[str]) -> None:
    """Put lines between ``<!-- NAME -->`` and ``<!-- /NAME -->``, at the end of a file that lacks the marks."""
    begin, end = f"<!-- {name} -->", f"<!-- /{name} -->"
    block = "\n".join([begin, *lines, end])
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    before, found, rest = text.partition(begin)
    if found:
        after = rest.partition(end)[2]
        text = f"{before}{block}{after}"
    else:
        text = f"{text.rstrip()}\n\n{block}\n".lstrip()
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
