"""The stability matrix: cases against methods, from the rows of a stability JSON beside the run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from orca.errors import BadInput
from orca.json_file import read_json_file

__all__ = ["CLASSES", "find_stability", "read_stability"]

# Outcome -> how the page colours it.
CLASSES = {
    "exact": "good",
    "ok": "good",
    "degraded": "fair",
    "typed failure": "told",
    "crash": "bad",
    "time-out": "bad",
    "out of memory": "bad",
    "silent wrong": "bad",
}
_NAMES = ("stability.json", "stability/stability.json", "tables/stability.json")


def find_stability(root: Path) -> Path | None:
    """The stability JSON in a run's folder, or beside it; None when there is none."""
    candidates = [root / name for name in _NAMES] + [root.parent / "stability" / "stability.json"]
    return next((path for path in candidates if path.is_file()), None)


def read_stability(path: Path) -> dict[str, Any]:
    """Cases, methods and cells of a stability JSON: rows of `case`, `method`, `outcome`, `detail`, `seconds`.

    The rows are the document itself, or its "rows". Where they say so, a cell that was "measured" elsewhere is marked
    by an asterisk, and one that is not "as_expected" by an exclamation mark; "about" says what a case is.

    Raises:
        BadInput: not such a file.
    """
    allowed = 'rows of "case", "method", "outcome", "detail" and "seconds", as bench stability --json writes them'
    try:
        document = read_json_file(path, allowed)
        rows = document["rows"] if isinstance(document, dict) else document
        cells = {(str(row["case"]), str(row["method"])): _cell(row) for row in rows}
    except (KeyError, TypeError) as error:
        raise BadInput(f"{path} ({type(error).__name__}: {error})", allowed, "write it again") from error
    cases = list(dict.fromkeys(case for case, _ in cells))
    methods = list(dict.fromkeys(method for _, method in cells))
    about = {str(row["case"]): str(row.get("about") or "") for row in rows}
    table = [
        {"case": case, "about": about[case], "cells": [cells.get((case, method)) for method in methods]}
        for case in cases
    ]
    totals = [_totals([cells.get((case, method)) for case in cases]) for method in methods]
    return {"methods": methods, "rows": table, "totals": totals, "cases": len(cases)}


def _cell(row: dict[str, Any]) -> dict[str, Any]:
    outcome = str(row["outcome"])
    seconds = row.get("seconds")
    remarks = ["known from elsewhere"] if row.get("measured") is False else []
    remarks += ["not as expected"] if row.get("as_expected") is False else []
    return {
        "outcome": outcome,
        "mark": "*" * (row.get("measured") is False) + "!" * (row.get("as_expected") is False),
        "remarks": "".join(f". {remark.capitalize()}" for remark in remarks),
        "class": CLASSES.get(outcome.replace("_", " ").replace("timeout", "time-out").lower(), "told"),
        "detail": str(row.get("detail") or ""),
        "seconds": f"{seconds:.1f} s" if isinstance(seconds, int | float) else "",
    }


def _totals(cells: list[dict[str, Any] | None]) -> str:
    counts: dict[str, int] = {}
    for cell in cells:
        if cell is not None:
            counts[cell["outcome"]] = counts.get(cell["outcome"], 0) + 1
    return ", ".join(f"{count} {outcome}" for outcome, count in counts.items())
