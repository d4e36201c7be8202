"""How the cost of the bench grows with the number of scenes: ``python -m tests.scale --out DIR [--report]``.

A mock method (it copies the input) and a mock metric, over the real store: every scene has a record of 50 frames and 50
values a frame, its frames, its cameras and its cached score. The first hundred scenes are run; the others are copies of
their files under other names, under seals of their own: what a longer run would have left, without the hours. Each step
runs in a process of its own, whose CPU seconds (user and system), seconds on the clock and peak resident memory are
printed; the last line of each step is its growth between the last two sizes, as an exponent: 1 is linear, 0 flat.

start: a new run, up to the moment at which its first scene would begin. fill: the files are made. resume: the same
command when nothing is left to do. tables: all scenes and the mean over them, in every form. merge: with itself.
``--report`` writes what came out into reports/scale/README.md.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from bench.digest import sealed
from bench.measured import read_runs
from bench.merge import merge_runs
from bench.processes import memory_mb
from bench.progress import Reporter
from bench.request import RunRequest
from bench.runner import keep_summary, run_bench
from bench.scenework import SceneOutcome, SceneWork
from bench.store import RunStore, read_json
from bench.tables import dataset_table, scene_table, write_tables
from tests.bench.worker_fakes import METHODS, METRICS, Scenes, request_of
from tests.report_block import REPORT, put_block

FRAMES = 50
RUN = 100
STEPS = ("start", "fill", "resume", "tables", "merge")


def request_at(folder: Path, scenes: int) -> RunRequest:
    """The run whose cost is asked for."""
    request = request_of(folder, count=scenes)
    return replace(request, dataset=Scenes(scenes, FRAMES), methods=("copy",), metrics=("grey",))


def step(name: str, folder: Path, scenes: int) -> None:
    """Do one step, in this process."""
    request = request_at(folder, scenes)
    if name == "start":
        try:
            run_bench(replace(request, out=folder / "started"), None, METHODS, METRICS, _Stops())
        except _Started:
            return
        raise RuntimeError("no scene was handed out")
    if name == "fill":
        fill(request)
    elif name == "resume":
        summary = run_bench(request, None, METHODS, METRICS)
        if summary.computed:
            raise RuntimeError(f"{summary.computed} cells were computed again")
    elif name == "tables":
        run = read_runs([request.out], slim=True)
        tables = (dataset_table(run), scene_table(run))
        write_tables(request.out / "tables", tables)
        (folder / "printed").write_text("\n".join(table.to_text() for table in tables))
    else:
        merge_runs(folder / "merged", [folder / "run", folder / "run"], METHODS, METRICS)


class _Started(Exception):
    """The first scene would begin now."""


class _Stops:
    """An executor that does nothing."""

    def run(self, work: SceneWork, scenes: Sequence[str], reporter: Reporter) -> Iterator[SceneOutcome]:
        """Raise at once."""
        raise _Started


def fill(request: RunRequest) -> None:
    """Run the first scenes, copy their files under the names of the others, and end as a run ends."""
    first = request.scenes[:RUN]
    run_bench(replace(request, scenes=first), None, METHODS, METRICS)
    store = RunStore(request.out)
    model = {scene: read_json(store.record_path("copy", scene)) for scene in first}
    for i, scene in enumerate(request.scenes[RUN:]):
        source = first[i % len(first)]
        shutil.copyfile(store.frames_path("copy", source), store.frames_path("copy", scene))
        record = sealed({**model[source], "scene": scene})
        text = json.dumps(record, indent=1, allow_nan=False, ensure_ascii=False)
        store.record_path("copy", scene).write_text(text + "\n")
    if len(request.scenes) > RUN:
        run = store.load_run() or {}
        store.save_run({**run, "scenes": list(request.scenes)})
        keep_summary(store)


def measured(name: str, folder: Path, scenes: int) -> dict[str, Any]:
    """Seconds and memory of one step in a fresh process."""
    command = [sys.executable, "-m", "tests.scale", "--out", str(folder), "--step", name, "--sizes", str(scenes)]
    before, started = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    own = json.loads(done.stdout.strip().splitlines()[-1])
    return {"wall_s": time.perf_counter() - started, "cpu_s": cpu, **own}


def peak_mb() -> float:
    """Largest resident set of this process, MB of 1e6 bytes."""
    return memory_mb("VmHWM") or math.nan


def growth(rows: Sequence[dict[str, Any]], sizes: Sequence[int], key: str) -> float:
    """The exponent of the growth between the last two sizes, once what a process costs anyway is taken off."""
    first, *_, a, b = [row[key] for row in rows]
    if min(a, b) <= first:
        return 0.0
    return math.log((b - first) / (a - first)) / math.log((sizes[-1] - sizes[0]) / (sizes[-2] - sizes[0]))


def main() -> None:
    """Measure every step at every size."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="gets the runs, about 30 kB a scene")
    parser.add_argument("--sizes", default="1,2500,5000,10000", help="numbers of scenes (1,2500,5000,10000)")
    parser.add_argument("--steps", default=",".join(STEPS), help="of " + ", ".join(STEPS))
    parser.add_argument("--report", action="store_true", help="write the result into reports/scale/README.md")
    parser.add_argument("--step", help=argparse.SUPPRESS)
    args = parser.parse_args()
    sizes = [int(size) for size in args.sizes.split(",")]
    if args.step:
        step(args.step, args.out, sizes[0])
        print(json.dumps({"peak_mb": peak_mb()}))
        return
    load, lines = os.getloadavg()[0], []
    for name in args.steps.split(","):
        rows = []
        for size in sizes:
            rows.append(measured(name, args.out / str(size), size))
            numbers = ", ".join(f"{key} {value:.2f}" for key, value in rows[-1].items())
            print(f"{name}, {size} scenes: {numbers}", flush=True)
        exponents = [f"{growth(rows, sizes, key):.2f}" for key in ("cpu_s", "peak_mb")] if len(sizes) > 2 else ["", ""]
        print(f"{name}: grows with scenes^{exponents[0]} (CPU), ^{exponents[1]} (memory)", flush=True)
        lines += in_words(name, rows, sizes, exponents)
    if args.report:
        put_block(REPORT, "scenes", [*_head(args.sizes, load), *lines])


def _head(sizes: str, load: float) -> list[str]:
    return [
        f"`python -m tests.scale --out DIR --sizes {sizes} --report`, {datetime.now(UTC):%d %B %Y}; load "
        f"{load:.1f} before and {os.getloadavg()[0]:.1f} after, on {os.cpu_count()} cores. Each row is a process "
        "of its own; growth is the exponent between the two largest sizes, what one scene costs taken off.",
        "",
        "| step | scenes | CPU seconds | on the clock | peak MB | growth of CPU | of memory |",
        "|---|---:|---:|---:|---:|---:|---:|",
    ]


def in_words(name: str, rows: Sequence[dict[str, Any]], sizes: Sequence[int], exponents: Sequence[str]) -> list[str]:
    """The rows of one step as Markdown, its growth in the last."""
    lines = []
    for size, row in zip(sizes, rows, strict=True):
        grown = exponents if size == sizes[-1] else ("", "")
        numbers = f"{row['cpu_s']:.1f} | {row['wall_s']:.1f} | {row['peak_mb']:.0f} | {grown[0]} | {grown[1]}"
        lines.append(f"| {name} | {size:,} | {numbers} |")
    return lines


if __name__ == "__main__":
    main()
