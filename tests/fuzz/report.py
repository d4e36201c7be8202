"""The table of fuzzing: minutes, executions and findings by target, from the lines that runs left."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from tests.fuzz.targets import TARGETS

__all__ = ["LOG", "read_log", "write_report"]

_ROOT = Path(__file__).resolve().parents[2]
LOG = _ROOT / "reports" / "fuzz" / "runs.jsonl"
"""One line for each piece of fuzzing."""
_HEAD = """# Fuzzing

`pip install -e '.[fuzz]'`, then `python -m tests.fuzz TARGET --seconds N` (Atheris; coverage of the Python code, not of
compiled decoders), or `sh tests/fuzz/background.sh` for ten minutes of computing of each.
A finding is an input on which a parser raised anything but its own error, crashed, hung for ten minutes, or took two
gigabytes. Findings that were fixed are kept in `tests/fuzz/corpus` and read again by every test run.

| target | what reads it | minutes of computing | by the clock | executions | places found |
|---|---|---:|---:|---:|---:|
"""

_FOUND = """
## Findings, all fixed

- nerfstudio: a `camera_angle_x` of 0 divided by zero.
- ply: two properties of one name reached numpy.
- depth: an NPY header that is no Python expression got through as `tokenize.TokenError`; shapes that overflow are now
  compared with the size of the file before anything is read.
- video: a stream of a codec that nobody knows has no decoder to ask.
- onnx: **malformed networks crash OpenCV 5.0.0** (signal 11, two inputs). That is not ours to mend: each network is
  first read and run once in a process of its own, and refused if that one dies. It is no sandbox.
- depth: **OpenCV 5.0.0 takes the memory that a part of a PNG claims**, up to 4 GB for a file of 90 bytes. How a PNG is
  divided is now read before anything is decoded. The runs that found it also waited for it: they are why `depth` has
  few executions.
- record: a `timing` that is no object; an import of ours that was missing for five minutes.
- run: eleven places in `bench merge`, `bench verify` and the curves that a part of another type got through to (lists
  for names, numbers for blocks, NaN under a seal, cameras under a name that is no hash). 14,500 documents changed by
  `tests/fuzz/mutate.py` found them, the last 3,000 nothing more; they are kept in `tests/bench/test_untrusted_run.py`.
  **Atheris itself has not run on `run` yet**: this target is new, and the machine had no time left for it.

Found by reading, and tested: a video that is a concat playlist and leads the decoder to other files; EPS, for which
Pillow starts Ghostscript; JSON nested without end; scenes with NaN, other types or a renderer's limit of 10^12; stored
frames that are a compressed bomb; weights whose hash is not the one in their name.

libFuzzer's time-outs and slow units were run again: each input takes less than 0.3 s, after a first call of at most
3.8 s (imports); the machine had been paused. `onnx` is slow because each network that OpenCV reads is tried in a
process of its own.

Minutes are by the clock, on two cores that others used (load 3 to 17), at the lowest priority and with pauses. Time of
computing is what the fuzzer got of them; the first 17 runs (18 minutes by the clock) did not write it down. **Ten
minutes by the clock are not ten minutes of computing: no target had those, and nine had not even ten by the clock.**
Let them run longer on an idle machine.
"""


def read_log(log: Path) -> list[dict[str, Any]]:
    """The pieces of fuzzing so far; none where there is no log."""
    return [json.loads(line) for line in log.read_text().splitlines()] if log.exists() else []


def write_report(log: Path = LOG, docs: Path = _ROOT / "docs") -> Path:
    """Write docs/fuzzing.md from the log; return its path."""
    runs = read_log(log)
    rows = []
    for name, target in TARGETS.items():
        mine = [run for run in runs if run["target"] == name]
        found = {_place(finding) for run in mine for finding in run["findings"]}
        rows.append(f"| {name} | {target.reads} | {_sums(mine)} | {len(found)} |")
    path = docs / "fuzzing.md"
    path.parent.mkdir(exist_ok=True)
    path.write_text(_HEAD + "\n".join([*rows, f"| all | | {_sums(runs)} | |"]) + "\n" + _FOUND, encoding="utf-8")
    return path


def _sums(runs: list[dict[str, Any]]) -> str:
    """Minutes of computing and by the clock, executions."""
    computing, clock = (sum(run[key] for run in runs) / 60 for key in ("cpu_seconds", "seconds"))
    return f"{computing:.1f} | {clock:.1f} | {sum(run['executions'] for run in runs):,}"


def _place(finding: str) -> str:
    """What a file of findings stands for: inputs that take too much memory are one place."""
    return re.sub(r"^(crash-oom)-.*", r"\1", finding)
