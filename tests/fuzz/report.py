"""The table of fuzzing: minutes, executions and findings by target, from the lines that runs left."""

from __future__ import annotations

import json
from collections import defaultdict
from pathlib import Path

from tests.fuzz.targets import TARGETS

__all__ = ["write_report"]

_NONE = (".txt", "timeout", "slow-unit")  # a traceback; a machine that was paused, see below
_DOCS = Path(__file__).resolve().parents[2] / "docs"
_HEAD = """# Fuzzing

`python -m tests.fuzz TARGET --seconds N` (Atheris; coverage of the Python code, not of compiled decoders).
A finding is an input on which a parser raised anything but its own error, crashed, hung for ten minutes, or took two
gigabytes. Findings that were fixed are kept in `tests/fuzz/corpus` and read again by every test run.

| target | what reads it | minutes | executions | places found |
|---|---|---:|---:|---:|
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
- record: an import of ours that was missing for five minutes.

Found by reading, and tested: a video that is a concat playlist and leads the decoder to other files; EPS, for which
Pillow starts Ghostscript; JSON nested without end; scenes with NaN, other types or a renderer's limit of 10^12; stored
frames that are a compressed bomb; weights whose hash is not the one in their name.

libFuzzer's time-outs (4) were run again: each input takes less than 0.3 s; the machine was paused. The minutes are by
the clock, on two cores with a load of 12 to 17, at the lowest priority: the later runs had a tenth of a core or less.
That is far from ten minutes of computing for each target: let them run longer on an idle machine.
"""


def write_report(runs: Path) -> Path:
    """Write docs/fuzzing.md; return its path."""
    seconds: defaultdict[str, float] = defaultdict(float)
    executions: defaultdict[str, int] = defaultdict(int)
    found: defaultdict[str, set[str]] = defaultdict(set)
    for line in runs.read_text().splitlines():
        run = json.loads(line)
        seconds[run["target"]] += run["seconds"]
        executions[run["target"]] += run["executions"]
        found[run["target"]] |= {name for name in run["findings"] if not any(word in name for word in _NONE)}
    rows = [
        f"| {name} | {target.reads} | {seconds[name] / 60:.1f} | {executions[name]:,} | {len(found[name])} |"
        for name, target in TARGETS.items()
    ]
    total = f"| all | | {sum(seconds.values()) / 60:.1f} | {sum(executions.values()):,} | |"
    path = _DOCS / "fuzzing.md"
    path.parent.mkdir(exist_ok=True)
    path.write_text(_HEAD + "\n".join([*rows, total]) + "\n" + _FOUND, encoding="utf-8")
    return path
