"""The files of a run without what no two runs share."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

_VOLATILE = ("timing", "host")
# What was typed where, and the state of the code, are facts of a run too. The seal is over them.
_OF_THE_RUN = ("argv", "folders", "code", "digest")
# The long table says when a library wrote it; a lock is empty; tables are made of the rest.
_LEFT_OUT = ("scores.parquet", ".lock", "tables")


def lasting(run: Path, also: tuple[str, ...] = ()) -> dict[str, Any]:
    """Path -> content of every file below ``run``: bytes, or JSON without timing and host (``also``: more parts)."""
    found: dict[str, Any] = {}
    for path in sorted(p for p in run.rglob("*") if p.is_file()):
        name = path.relative_to(run)
        if name.parts[0] in (*_LEFT_OUT, *also):
            continue
        content: Any = path.read_bytes()
        if path.suffix == ".json":
            document = json.loads(content)
            content = {key: value for key, value in document.items() if key not in _VOLATILE}
            if name.parts[0] == "run.json":
                content = {key: value for key, value in content.items() if key not in _OF_THE_RUN}
        found[str(name)] = content
    return found
