"""The input view of a run against regular grids: ``python -m tests.input_view RUN``.

Writes reports/realmdreamer-draft/input_view.md, from the records of `orca` and from reports/anchors/anchors.csv.
"""

from __future__ import annotations

import argparse
import csv
import json
from pathlib import Path
from typing import Any

_REPORTS = Path(__file__).resolve().parents[1] / "reports"
_HEAD = """### Input view against the optimum of regular grids, and what is left open

`orca` with `draft` in the run beside this file (`python -m tests.input_view RUN`), against the closed-form optimum of
regular grids of 65,536 and 131,044 anchors over the input alone, on the plane (`reports/anchors/anchors.csv`). ORCA's
anchors: inside the input (as many as the smaller grid) + in the outpainted margin + inserted by repair, which stay
hidden from the input view. ORCA is measured at the scene's depth, repairs included. Holes: share of pixels under half
covered, mean / worst frame.

| Scene | Anchors | 65k grid [dB] | 131k grid [dB] | orca [dB] | over 65k | over 131k | Repairs | Holes [%] |
| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |"""


def main() -> None:
    """Write the table and print it."""
    parser = argparse.ArgumentParser(prog="python -m tests.input_view", description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path, metavar="RUN", help="folder of a run")
    grids = _grids(_REPORTS / "anchors" / "anchors.csv")
    lines, over = [_HEAD], []
    for path in sorted((parser.parse_args().run / "scenes" / "orca").glob("*.json")):
        record = json.loads(path.read_text())
        small, large = grids[record["scene"]][:2]
        psnr = record["scores"]["input_psnr"]["value"]
        over.append((psnr - small, psnr - large))
        lines.append(_row(record, small, large, psnr))
    mean, least = sum(a for a, _ in over) / len(over), min(a for a, _ in over)
    above = sum(b > 0 for _, b in over)
    lines += [
        "",
        f"Mean {mean:+.2f} dB over the 65k grid (smallest {least:+.2f}), above the 131k grid on {above} of {len(over)} "
        f"(smallest {min(b for _, b in over):+.2f} dB).",
    ]
    text = "\n".join(lines) + "\n"
    (_REPORTS / "realmdreamer-draft" / "input_view.md").write_text(text)
    print(text)


def _grids(path: Path) -> dict[str, list[float]]:
    """PSNR of each scene's regular grids, the coarsest first."""
    found: dict[str, list[float]] = {}
    with path.open(newline="") as file:
        for row in csv.DictReader(file):
            if row["placement"] == "grid":
                found.setdefault(row["scene"], []).append(float(row["psnr_db"]))
    return found


def _row(record: dict[str, Any], small: float, large: float, psnr: float) -> str:
    stages, holes = record["model"]["anchors_by_stage"], record["scores"]["hole_fraction"]
    counts = " + ".join(str(stages[stage]) for stage in ("original", "outpainted", "repaired"))
    return (
        f"| {record['scene']} | {counts} | {small:.2f} | {large:.2f} "
        f"| {psnr:.2f} | {psnr - small:+.2f} | {psnr - large:+.2f} "
        f"| {record['model']['repairs']} | {100 * holes['value']:.2f} / {100 * max(holes['per_frame']):.2f} |"
    )


if __name__ == "__main__":
    main()
