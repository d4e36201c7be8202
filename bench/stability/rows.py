"""The rows of a stability run: written after each, so that nothing done is lost and nothing is done twice."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from bench.host import host_facts
from bench.stability.case import StabilityCase
from bench.stability.catalogue import CASES, CASES_VERSION
from bench.stability.known import KNOWN_ROWS
from bench.stability.outcome import OUT_OF_MEMORY, TIME_OUT
from bench.stability.worker import Limits, Report
from bench.store import read_json, write_json
from orca.errors import BadInput

__all__ = ["StabilityRows"]

Row = dict[str, Any]


class StabilityRows:
    """``stability.json`` in a folder: one row for each case and method, in the order of the cases.

    Args:
        folder: of the run; made when the first row is written.

    Raises:
        BadInput: the file that is there is not one of these.
    """

    def __init__(self, folder: Path) -> None:
        self.path = Path(folder) / "stability.json"
        self._rows: dict[tuple[str, str], Row] = {}
        if self.path.is_file():
            self._read()

    def _read(self) -> None:
        document = read_json(self.path)
        try:
            rows = [row for row in document["rows"] if row["measured"]]
            self._rows = {(row["case"], row["method"]): row for row in rows if row["version"] and row["limits"]}
        except (KeyError, TypeError) as error:
            raise BadInput(
                f"{self.path} with a broken row ({error})", "what bench stability writes", "give another --out"
            ) from error

    def finished(self, case: StabilityCase, method: str, version: str, limits: Limits) -> bool:
        """Whether the row is there, of this version; one that ran into a limit counts only for the same limits."""
        row = self._rows.get((case.name, method))
        if row is None or row["version"] != _version(version):
            return False
        return row["outcome"] not in (TIME_OUT, OUT_OF_MEMORY) or row["limits"] == asdict(limits)

    def add(self, case: StabilityCase, method: str, version: str, limits: Limits, report: Report) -> Row:
        """Write the row of a job; returns it."""
        outcome = report.verdict.outcome
        self._rows[case.name, method] = {
            "case": case.name,
            "group": case.group,
            "about": case.about,
            "method": method,
            "outcome": outcome,
            "expected": list(case.allowed(method)),
            "as_expected": outcome in case.allowed(method),
            "detail": report.verdict.detail,
            "seconds": round(report.seconds, 3),
            "cpu_s": round(report.cpu_s, 3),
            "peak_mb": None if report.peak_mb is None else round(report.peak_mb),
            "numbers": report.verdict.numbers,
            "measured": True,
            "version": _version(version),
            "limits": asdict(limits),
        }
        write_json(self.path, self.to_json())
        return self._rows[case.name, method]

    def rows(self, cases: Sequence[str] | None = None, methods: Sequence[str] | None = None) -> list[Row]:
        """The measured rows, those of some cases and methods only, and beside them what is known from elsewhere."""
        order = {case.name: number for number, case in enumerate(CASES)}
        found = [row for (case, method), row in self._rows.items() if cases is None or case in cases]
        found = [row for row in found if methods is None or row["method"] in methods]
        shown = {row["case"] for row in found}
        known = [dict(row) for row in KNOWN_ROWS if row["case"] in shown]
        return sorted([*found, *known], key=lambda row: order.get(row["case"], len(order)))

    def to_json(self) -> dict[str, Any]:
        """The whole file."""
        return {"schema_version": 1, "rows": self.rows(), "machine": host_facts()}


def _version(method: str) -> str:
    return f"{method}; cases {CASES_VERSION}"
