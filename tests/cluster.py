"""Two Ray workers against one process on the same scenes: ``python -m tests.cluster``.

A Ray cluster of two nodes with a core each is started on this machine. Synthetic scenes are run in one process with one
thread, and by the cluster, a scene a task with a core; each from nothing, in a process of its own, imports and
compilation included, the start of the cluster left out. Then the files of both runs are compared byte for byte
(`tests.bench.run_files.lasting` says what is left out: timing, host, and what names the folder). The exit code is 1
unless they are equal. ``--report`` writes what came out into reports/scale/README.md.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from bench.datasets.synthetic import Synthetic
from bench.executors import Executor, InThisProcess, Resources
from bench.executors.ray_cluster import RayCluster
from bench.request import RunRequest
from bench.runner import run_bench
from tests.bench.run_files import lasting
from tests.faults.forks import ONE_THREAD
from tests.report_block import REPORT, put_block

__all__ = ["NEEDS", "Compared", "compared", "two_nodes"]

NEEDS = Resources(cores=1, memory_gib=0.2)
METHODS, METRICS = ("warp", "warp-telea"), ("hole_fraction", "psnr", "tsed")


@contextmanager
def two_nodes() -> Iterator[str]:
    """The address of a Ray cluster of two nodes with a core each, on this machine."""
    from ray.cluster_utils import Cluster

    os.environ["RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO"] = "0"
    os.environ["RAY_worker_niceness"] = "0"  # noqa: SIM112 Ray spells it so; else tasks wait for all that runs here
    memory = {"num_cpus": 1, "object_store_memory": 80 * 2**20, "memory": 2**30, "include_dashboard": False}
    started = Cluster(initialize_head=True, head_node_args=memory)
    try:
        started.add_node(**memory)
        started.wait_for_nodes()
        yield started.address
    finally:
        started.shutdown()


def run(out: Path, scenes: int, size: int, address: str | None) -> None:
    """The run, in this process: here, or by the cluster at the address."""
    import cv2

    cv2.setNumThreads(1)
    dataset = Synthetic(size=size)
    executor: Executor = InThisProcess() if address is None else RayCluster(address, resources=NEEDS)
    summary = run_bench(RunRequest(dataset, tuple(dataset.scenes()[:scenes]), METHODS, METRICS, out), executor=executor)
    if summary.failed or summary.computed != scenes * len(METHODS):
        raise RuntimeError(f"{summary.computed} cells computed, failed: {summary.failed}")


@dataclass(frozen=True)
class Compared:
    """What became of two runs.

    Attributes:
        one_s, two_s: seconds on the clock, of one process and of two workers.
        files, size: how many files were compared, and their bytes.
        different: names of those that are not equal, or only in one.
    """

    one_s: float
    two_s: float
    files: int
    size: int
    different: tuple[str, ...]


def compared(folder: Path, scenes: int, size: int) -> Compared:
    """Run both and compare."""
    with two_nodes() as address:
        seconds = [_timed(folder / name, scenes, size, to) for name, to in (("one", None), ("two", address))]
    one, two = lasting(folder / "one"), lasting(folder / "two")
    different = tuple(name for name in sorted({*one, *two}) if one.get(name) != two.get(name))
    return Compared(*seconds, len(one), sum(map(len, one.values())), different)


def _timed(out: Path, scenes: int, size: int, address: str | None) -> float:
    command = [sys.executable, "-m", "tests.cluster", "--run", str(out), "--scenes", str(scenes), "--size", str(size)]
    started = time.perf_counter()
    subprocess.run([*command, *([] if address is None else ["--address", address])], check=True, env=_one_thread())
    return time.perf_counter() - started


def _one_thread() -> dict[str, str]:
    return {**os.environ, **ONE_THREAD}


def in_words(found: Compared, scenes: int, size: int, load: tuple[float, float]) -> list[str]:
    """The result as Markdown."""
    same = "all equal" if not found.different else f"{len(found.different)} differ: {', '.join(found.different[:5])}"
    return [
        f"`python -m tests.cluster --scenes {scenes} --size {size} --report`, {datetime.now(UTC):%d %B %Y}; load "
        f"{load[0]:.1f} before and {load[1]:.1f} after, on {os.cpu_count()} cores; methods {', '.join(METHODS)}; "
        f"metrics {', '.join(METRICS)}.",
        "",
        "| who | seconds on the clock | files compared | bytes |",
        "|---|---:|---:|---:|",
        f"| one process, one thread | {found.one_s:.1f} | {found.files} | {found.size:,} |",
        f"| 2 Ray workers, a core each | {found.two_s:.1f} | {same} | |",
        f"| speed-up | {found.one_s / found.two_s:.2f} | | |",
    ]


def main() -> int:
    """Both runs, or one of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=8, metavar="N", help="of the synthetic data set (8)")
    parser.add_argument("--size", type=int, default=512, metavar="PX", help="side of a scene (512)")
    parser.add_argument("--report", action="store_true", help=f"write the result into {REPORT.name} of reports/scale")
    parser.add_argument("--run", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--address", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.run:
        run(args.run, args.scenes, args.size, args.address)
        return 0
    before = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as folder:
        found = compared(Path(folder), args.scenes, args.size)
    lines = in_words(found, args.scenes, args.size, (before, os.getloadavg()[0]))
    print("\n".join(lines))
    print(json.dumps({"different": found.different}))
    if args.report:
        put_block(REPORT, "cluster", lines)
    return 1 if found.different else 0


if __name__ == "__main__":
    sys.exit(main())
