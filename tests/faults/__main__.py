"""``python -m tests.faults [NAME...]``: inject every fault, or those, and write docs/faults.md."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from tests.faults.forks import Forks
from tests.faults.scenarios import SCENARIOS
from tests.faults.workbench import Told, Workbench

OPEN = "not injected by the script yet"
DOCS = Path(__file__).resolve().parents[2] / "docs" / "faults.md"
_HEAD = """# Faults

Made by `python -m tests.faults`, which injects every one of them; the tests do the same (`tests/bench/test_faults.py`,
`test_faults_kill.py`) and compare the words. What happened is put together from what was seen: how the process ended,
what it printed, what the results say, which methods the second run called. Lost: files that differ from an
uninterrupted run's apart from timing and host, finished cells that were computed again, files that are half written
under their name.

Write points are named in `orca/faults.py`: `ORCA_FAULT="kill written */scenes/*/*.json 3"` kills the process when it
has written its third result and not yet given it its name. `bench/timelimit.py` is the limit of `--cell-timeout`.

| injected | what happened | lost |
|---|---|---|
"""


def main() -> int:
    """Run every scenario, or those named; each row is written as soon as it is known."""
    rows = _written() if len(sys.argv) > 1 else {}
    with Forks("tests.faults.jobs:bench_job") as forks:
        for name in sys.argv[1:] or SCENARIOS:
            with tempfile.TemporaryDirectory() as folder:
                try:
                    told = SCENARIOS[name](Workbench(forks, Path(folder)))
                except PermissionError as error:
                    told = Told(f"not injected: {error}", ())
            rows[name] = f"| {name} | {told.happened} | {'; '.join(told.lost) or 'nothing'} |"
            print(rows[name], flush=True)
            DOCS.parent.mkdir(exist_ok=True)
            DOCS.write_text(table_of(rows), encoding="utf-8")
    return 0 if all(row.endswith("| nothing |") for row in rows.values()) else 1


def table_of(rows: dict[str, str]) -> str:
    """The file; a fault that the script has not injected yet says so."""
    return _HEAD + "".join(f"{rows.get(name, f'| {name} | {OPEN} | not known |')}\n" for name in SCENARIOS)


def _written() -> dict[str, str]:
    lines = DOCS.read_text(encoding="utf-8").splitlines() if DOCS.is_file() else []
    rows = (line for line in lines if line.startswith("| ") and OPEN not in line)
    return {row.split(" | ")[0].removeprefix("| "): row for row in rows}


if __name__ == "__main__":
    sys.exit(main())
