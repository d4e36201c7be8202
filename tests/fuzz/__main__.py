"""``python -m tests.fuzz TARGET --seconds N [--out DIR]``: fuzz a parser; ``--report`` writes docs/fuzzing.md.

Each run adds a line to OUT/runs.jsonl: seconds, executions, findings. A finding is an input that made a parser raise
anything but an `OrcaError`, crash, take more than ten minutes or two gigabytes; it lies in OUT/findings/TARGET.
"""

from __future__ import annotations

import argparse
import json
import re
import resource
import shutil
import subprocess
import sys
import time
from pathlib import Path

from tests.fuzz.report import write_report
from tests.fuzz.seeds import dictionary, seeds
from tests.fuzz.targets import TARGETS, folder

_HERE = Path(__file__).resolve().parent


def main() -> int:
    """Fuzz, or write the report."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__.splitlines()[0])
    parser.add_argument("targets", nargs="*", metavar="TARGET", help=", ".join(TARGETS))
    parser.add_argument("--seconds", type=int, default=60, metavar="N", help="of each target (60)")
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"), metavar="DIR", help="where to work (out/fuzz)")
    parser.add_argument("--report", action="store_true", help="write docs/fuzzing.md from OUT/runs.jsonl")
    args = parser.parse_args()
    for name in args.targets:
        if name not in TARGETS:
            parser.error(f"no target {name!r}: {', '.join(TARGETS)}")
        print(json.dumps(_fuzz(name, args.seconds, args.out)), flush=True)
    if args.report:
        print(write_report(args.out / "runs.jsonl"))
    return 0


def _fuzz(name: str, seconds: int, out: Path) -> dict[str, object]:
    """Start the engine again after each crash, until the time is up."""
    corpus, findings = out / "corpus" / name, out / "findings" / name
    for place in (corpus, findings):
        place.mkdir(parents=True, exist_ok=True)
    for number, content in enumerate(seeds(name)):
        (corpus / f"seed-{number}").write_bytes(content)
    words = out / f"{name}.dict"
    words.write_text(dictionary(name))
    before = {path.name for path in findings.iterdir()}
    started, executions, crashes, before_cpu = time.time(), 0, 0, _cpu_of_children()
    while (left := seconds - (time.time() - started)) > 1:
        done, crashed = _engine(name, left, corpus, findings, words)
        executions, crashes = executions + done, crashes + crashed
        if crashes > 50:
            break
    run = {
        "target": name,
        "seconds": round(time.time() - started),
        "cpu_seconds": round(_cpu_of_children() - before_cpu),
        "executions": executions,
        "corpus": len(list(corpus.iterdir())),
        "findings": sorted({path.name for path in findings.iterdir()} - before),
    }
    with (out / "runs.jsonl").open("a") as file:
        file.write(json.dumps(run) + "\n")
    return run


def _cpu_of_children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _engine(name: str, seconds: float, corpus: Path, findings: Path, words: Path) -> tuple[int, bool]:
    """One run of the engine; returns executions, and whether it ended before its time."""
    command = [sys.executable, "-m", "tests.fuzz.engine", name, str(findings.absolute())]
    command += [f"-max_total_time={max(1, int(seconds))}", f"-max_len={TARGETS[name].max_bytes}", "-timeout=600"]
    command += ["-rss_limit_mb=2048", "-print_final_stats=1", f"-artifact_prefix={findings.absolute()}/crash-"]
    command += [f"-dict={words}"] if words.stat().st_size else []
    kept = _HERE / "corpus" / name
    command += [str(corpus), *([str(kept)] if kept.is_dir() else [])]
    log = findings.parent / f"{name}.log"
    with log.open("wb") as file:
        process = subprocess.Popen(command, stdout=file, stderr=file)
        code = process.wait()
    for left in folder().parent.glob(f"orca-fuzz-{process.pid}-*"):  # libFuzzer ends without a word to Python
        shutil.rmtree(left, ignore_errors=True)
    text = log.read_text(errors="replace")
    done = re.findall(r"^#(\d+)|stat::number_of_executed_units: (\d+)", text, re.MULTILINE)
    return max((int(a or b) for a, b in done), default=0), code != 0


if __name__ == "__main__":
    sys.exit(main())
