"""``python -m tests.fuzz [TARGET ...] --seconds N``: fuzz parsers; ``--report`` writes docs/fuzzing.md.

Seconds are of computing, counted after start-up. Each piece of work adds a line to the log (reports/fuzz/runs.jsonl):
seconds, executions, findings. A finding is an input that made a parser raise anything but an `OrcaError`, crash, take
more than ten minutes or two gigabytes; it lies in OUT/findings/TARGET.
"""

from __future__ import annotations

import argparse
import json
import signal
import subprocess
import sys
import time
from pathlib import Path

from tests.fuzz.report import LOG, read_log, write_report
from tests.fuzz.seeds import dictionary, seeds
from tests.fuzz.supervise import artifact_repeats, supervise
from tests.fuzz.targets import TARGETS

_HERE = Path(__file__).resolve().parent
_PIECE_S = 300.0  # a line is written after each: what is broken off loses no more
_DEAD = 3  # starts in a row that did not run one input


def main() -> int:
    """Fuzz, or write the report."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__.splitlines()[0])
    parser.add_argument("targets", nargs="*", metavar="TARGET", help=", ".join(TARGETS))
    parser.add_argument("--seconds", type=int, default=60, metavar="N", help="of computing, of each target (60)")
    parser.add_argument("--fill", action="store_true", help="only what lacks to N in the log; all targets if none")
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"), metavar="DIR", help="where to work (out/fuzz)")
    parser.add_argument("--log", type=Path, default=LOG, metavar="FILE", help="the log (reports/fuzz/runs.jsonl)")
    parser.add_argument("--pause", type=Path, metavar="FILE", help="while it exists, the fuzzer is stopped")
    parser.add_argument("--report", action="store_true", help="write docs/fuzzing.md from the log")
    parser.add_argument("--list", action="store_true", help="print the names of the targets")
    args = parser.parse_args()
    if args.list:
        print(*TARGETS, sep="\n")
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that the engine is not left behind
    for name in args.targets:
        if name not in TARGETS:
            parser.error(f"no target {name!r}: {', '.join(TARGETS)}")
    for name in args.targets or (TARGETS if args.fill else ()):
        _fuzz(name, args)
    if args.report:
        print(write_report(args.log))
    return 0


def _fuzz(name: str, args: argparse.Namespace) -> None:
    """Piece after piece until the time is up, the engine started again after each crash."""
    spent, dead = 0.0, 0
    if args.fill:
        spent = sum(run["cpu_seconds"] for run in read_log(args.log) if run["target"] == name)
    while (left := args.seconds - spent) > 1 and dead < _DEAD:
        run = _piece(name, min(left, _PIECE_S), args.out, args.pause)
        spent += run["cpu_seconds"]
        dead = 0 if run["executions"] else dead + 1
        args.log.parent.mkdir(parents=True, exist_ok=True)
        with args.log.open("a") as file:
            file.write(json.dumps(run) + "\n")
        print(json.dumps(run), flush=True)


def _piece(name: str, cpu_seconds: float, out: Path, pause: Path | None) -> dict[str, object]:
    """One start of the engine, as a line of the log."""
    corpus, findings = out / "corpus" / name, out / "findings" / name
    for place in (corpus, findings):
        place.mkdir(parents=True, exist_ok=True)
    for number, content in enumerate(seeds(name)):
        (corpus / f"seed-{number}").write_bytes(content)
    words = out / f"{name}.dict"
    words.write_text(dictionary(name))
    before, started = set(findings.iterdir()), time.time()
    ended = supervise(_command(name, corpus, findings, words), cpu_seconds, findings.parent / f"{name}.log", pause)
    new = sorted(set(findings.iterdir()) - before)
    for artifact in [path for path in new if path.name.startswith(("crash-timeout", "crash-slow-unit"))]:
        if not artifact_repeats(name, artifact):
            artifact.unlink()
            new.remove(artifact)
    return {
        "target": name,
        "code": _code(),
        "seconds": round(time.time() - started),
        "cpu_seconds": round(ended.cpu_seconds, 1),
        "executions": ended.executions,
        "crashed": ended.crashed,
        "corpus": len(list(corpus.iterdir())),
        "findings": [path.name for path in new if path.suffix != ".txt"],
    }


def _command(name: str, corpus: Path, findings: Path, words: Path) -> list[str]:
    command = [sys.executable, "-m", "tests.fuzz.engine", name, str(findings.absolute())]
    command += [f"-max_len={TARGETS[name].max_bytes}", "-timeout=600", "-max_total_time=36000", "-rss_limit_mb=2048"]
    command += ["-print_final_stats=1", "-report_slow_units=120", f"-artifact_prefix={findings.absolute()}/crash-"]
    command += [f"-dict={words}"] if words.stat().st_size else []
    kept = _HERE / "corpus" / name
    return [*command, str(corpus), *([str(kept)] if kept.is_dir() else [])]


def _code() -> str:
    """The commit that is fuzzed: of this checkout, or as a copy of one says in FUZZED_COMMIT."""
    note = _HERE.parents[1] / "FUZZED_COMMIT"
    if note.exists():
        return note.read_text().strip()
    command = ["git", "-C", str(_HERE), "describe", "--always", "--dirty"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


if __name__ == "__main__":
    sys.exit(main())
