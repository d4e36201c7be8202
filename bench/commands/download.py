"""``bench download`` and ``bench depth``: filling a data root."""

from __future__ import annotations

import argparse
import logging
from collections import Counter
from pathlib import Path

from bench.commands.names import chosen
from bench.commands.outcome import Outcome
from bench.datasets import resolve_data_root
from orca.errors import OrcaError

__all__ = ["depth_command", "download_command"]

_log = logging.getLogger(__name__)


def download_command(args: argparse.Namespace) -> Outcome:
    """Fetch a data set; exit code 1 if a file failed.

    Raises:
        BadInput: no such data set.
        Unavailable: no network; says what goes where.
    """
    from bench.datasets.download import download

    root = resolve_data_root(args.data_root)
    seen: set[str] = set()

    def report(name: str, done: int, total: int) -> None:
        if name not in seen:
            seen.add(name)
            _log.info("fetching %s, %.1f MB", name, total / 1e6)

    items = download(args.what, root, dry_run=args.dry_run, report=report)
    lines = [f"{item.state:8} {item.path}" + _why(item.state, item.source, item.detail) for item in items]
    counts = Counter(item.state for item in items)
    lines.append(", ".join(f"{count} {state}" for state, count in counts.items()) + f"; data root {root}")
    document = {
        "schema_version": 1,
        "data_root": str(root),
        "files": [{"path": str(i.path), "state": i.state, "source": i.source, "detail": i.detail} for i in items],
    }
    return Outcome("\n".join(lines), document, 1 if counts["failed"] else 0)


def _why(state: str, source: str, detail: str) -> str:
    if state in ("here", "fetched"):
        return ""
    return "".join(f"\n         {line}" for line in (source, *detail.splitlines()) if line)


def depth_command(args: argparse.Namespace) -> Outcome:
    """Rebuild depth maps; a depth map that is there is compared with, not replaced, unless ``--out`` names a folder.

    Exit code 1 if a scene failed. Raises `Unknown` for a wrong scene.
    """
    from bench.datasets.depth_video import DepthScene, rebuild_depth
    from bench.datasets.realmdreamer import SCENES

    root = resolve_data_root(args.data_root)
    out = args.out or root / "realmdreamer" / "depth"
    lines, entries = [], []
    for scene in chosen("scene", args.scenes, SCENES, SCENES):
        try:
            made: DepthScene | None = rebuild_depth(root, scene, Path(out))
            problem = ""
        except OrcaError as error:
            made, problem = None, str(error)
        lines.append(f"{scene}: {problem}" if made is None else made.line())
        entries.append({"scene": scene, "problem": problem} | ({} if made is None else made.to_json()))
    failed = sum(bool(entry["problem"]) for entry in entries)
    return Outcome("\n".join(lines), {"schema_version": 1, "scenes": entries}, 1 if failed else 0)
