"""All cases on all methods: whatever is missing of the matrix is computed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from bench.adapters import METHODS, RunOptions
from bench.progress import Reporter
from bench.stability.case import StabilityCase
from bench.stability.job import CaseJob
from bench.stability.rows import StabilityRows
from bench.stability.worker import Limits, Worker

__all__ = ["StabilityRequest", "run_stability"]


@dataclass(frozen=True)
class StabilityRequest:
    """What to run.

    Attributes:
        cases: in their order.
        methods: names of methods.
        out: folder of the run.
        limits: of each job.
        preset: preset of ORCA.
        retry_unexpected: do rows again whose outcome was not as it should be.
    """

    cases: Sequence[StabilityCase]
    methods: Sequence[str]
    out: Path
    limits: Limits
    preset: str = "draft"
    retry_unexpected: bool = False


def run_stability(request: StabilityRequest, reporter: Reporter) -> StabilityRows:
    """Compute what is missing, writing each row as it is known.

    Raises:
        Unknown: no such method.
        BadInput: the folder holds something else.
    """
    options = RunOptions(preset=request.preset)
    versions = {method: METHODS.get(method).version(options) for method in request.methods}
    rows = StabilityRows(request.out)
    cells = [(case, method) for case in request.cases for method in request.methods if case.takes(method)]
    reporter.start(len(cells))
    try:
        with Worker(request.limits) as worker:
            for case, method in cells:
                if rows.finished(case, method, versions[method], request.limits) and not (
                    request.retry_unexpected and _unexpected(rows, case, method)
                ):
                    reporter.cell(None)
                    continue
                reporter.phase(case.name, method, "run", 0, 1)
                report = worker.run(CaseJob(case.name, method, request.preset))
                row = rows.add(case, method, versions[method], request.limits, report)
                mark = "" if row["as_expected"] else " UNEXPECTED"
                detail = f" ({row['detail']})" if row["detail"] else ""
                reporter.cell(f"{case.name} {method}: {row['outcome']}{mark}{detail}, {report.cpu_s:.1f} CPU-s")
    finally:
        reporter.close()
    return rows


def _unexpected(rows: StabilityRows, case: StabilityCase, method: str) -> bool:
    return any(row["as_expected"] is False for row in rows.rows([case.name], [method]))
