"""The table of fuzzing: minutes, executions and findings by target, from the lines that runs left."""

from __future__ import annotations

import json
import re
import textwrap
from pathlib import Path
from typing import Any

from tests.fuzz.targets import TARGETS

__all__ = ["LOG", "read_log", "write_report"]

_ROOT = Path(__file__).resolve().parents[2]
LOG = _ROOT / "reports" / "fuzz" / "runs.jsonl"
"""One line for each piece of fuzzing."""
_HEAD = """# Fuzzing

`pip install -e '.[fuzz]'`, then `python -m tests.fuzz TARGET --seconds N` (Atheris; coverage of the Python code, not of
compiled decoders), or `sh tests/fuzz/background.sh` for ten minutes of computing of each. A finding is an input on
which a parser raised anything but its own error, crashed, hung for ten minutes, or took two gigabytes. Findings that
were fixed are kept in `tests/fuzz/corpus` and read again by every test run.

The table is made by `python -m tests.fuzz --report` from `reports/fuzz/runs.jsonl`, a line for each piece of work, with
the commit that was fuzzed. Minutes of computing are what the processes used (user and system), their start-up left out;
executions are libFuzzer's count, which includes the corpus that each piece starts with.

| target | what reads it | minutes of computing | by the clock | executions | places found |
|---|---|---:|---:|---:|---:|
"""
_ENOUGH_S = 597.0  # ten minutes; the clock of processes is looked at twice a second, and the rest is not worth a start

_FOUND = """
## Findings, all fixed

- nerfstudio: a `camera_angle_x` of 0 divided by zero.
- ply: two properties of one name reached numpy; splats that are none could not be put into rows (found 28 November).
- depth: an NPY header that is no Python expression got through as `tokenize.TokenError`; shapes that overflow are now
  compared with the size of the file before anything is read.
- video: a stream of a codec that nobody knows has no decoder to ask.
- onnx: **malformed networks crash OpenCV 5.0.0** (signal 11, two inputs). That is not ours to mend: each network is
  first read and run once in a process of its own, and refused if that one dies. It is no sandbox.
- depth: **OpenCV 5.0.0 takes the memory that a part of a PNG claims**, up to 4 GB for a file of 90 bytes. How a PNG is
  divided is now read before anything is decoded.
- record: a `timing` that is no object; an import of ours that was missing for five minutes.
- run: eleven places in `bench merge`, `bench verify` and the curves that a part of another type got through to (lists
  for names, numbers for blocks, NaN under a seal, cameras under a name that is no hash). 14,500 documents changed by
  `tests/fuzz/mutate.py` found them; they are kept in `tests/bench/test_untrusted_run.py`.
- niqe: **malformed MATLAB files crash scipy's reader** (signal 11, 3 of 3,000 changed files), and broken compression
  got through as `zlib.error`. The two matrices are now read in Python (`bench/metrics/matlab_file.py`).
- weights: torch's reader of tensors fails as the file makes it fail (`IndexError` and others); any of it is now an
  error of the file, and what is read must be a dictionary of tensors.
- frames: stored text instead of pixels, which numpy converts by way of a `SystemError` of Python (found 28 November).
- chat: a server's `Retry-After` with the white space 0x1D was no number.

The findings of niqe and weights came from the test that changes bytes at random, when these targets were written; that
of chat from a trial of 15 seconds before the log of this table.

Found by reading, and tested: a video that is a concat playlist and leads the decoder to other files; EPS, for which
Pillow starts Ghostscript; JSON nested without end; scenes with NaN, other types or a renderer's limit of 10^12; stored
frames that are a compressed bomb; weights whose hash is not the one in their name.

Before this table: 1,077,119 executions in 94.9 minutes by the clock, on the 16 targets down to `tables` but `run`, with
code up to 22 November 2026. Their log is not here and they are not counted; how long they computed was mostly not
written down. Each target has started anew since.

A time-out of libFuzzer is by the clock, and machines pause: such an input is run again by itself, and is a finding if
that takes more than a minute of computing. `onnx` is slow because each network that OpenCV reads is tried in a process
of its own. Ten minutes of one process are little beside what a fuzzing farm would do.
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
    table = "\n".join([*rows, f"| all | | {_sums(runs)} | |"])
    path.write_text(f"{_HEAD}{table}\n\n{_enough(runs)}\n{_FOUND}", encoding="utf-8")
    return path


def _enough(runs: list[dict[str, Any]]) -> str:
    """Which targets had ten minutes of computing, in words."""
    spent = {name: sum(run["cpu_seconds"] for run in runs if run["target"] == name) for name in TARGETS}
    lack = [name for name, seconds in spent.items() if seconds < _ENOUGH_S]
    had = f"**{len(TARGETS) - len(lack)} of {len(TARGETS)} targets have had ten minutes of computing.**"
    least = (
        f" Not: {', '.join(lack)}; the least that any of them had is {min(spent.values()) / 60:.1f}." if lack else ""
    )
    return "\n".join(textwrap.wrap(had + least, 120))


def _sums(runs: list[dict[str, Any]]) -> str:
    """Minutes of computing and by the clock, executions."""
    computing, clock = (sum(run[key] for run in runs) / 60 for key in ("cpu_seconds", "seconds"))
    return f"{computing:.1f} | {clock:.1f} | {sum(run['executions'] for run in runs):,}"


def _place(finding: str) -> str:
    """What a file of findings stands for: inputs that take too much memory are one place."""
    return re.sub(r"^(crash-oom)-.*", r"\1", finding)
