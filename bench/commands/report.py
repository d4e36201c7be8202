"""``bench report``: a run as one page."""

from __future__ import annotations

import argparse
import logging

from bench.commands.outcome import Outcome
from orca.errors import BadInput

__all__ = ["report_command"]

_log = logging.getLogger(__name__)


def report_command(args: argparse.Namespace) -> Outcome:
    """Write the page. Raises `BadInput` for no run, a broken stability JSON, or a page that would be too large."""
    from bench.report import write_report

    if not args.max_mb > 0:
        raise BadInput(f"--max-mb {args.max_mb:g}", "more than 0", "leave it out for 30")
    out = args.out or args.run / "report.html"
    report = write_report(args.run, out, args.data_root, args.stability, int(args.max_mb * 1e6), _log.info)
    side, crf = report.video
    lines = [f"{report.path}: {report.num_bytes / 1e6:.1f} MB, {report.scenes} scenes, videos of at most {side} px"]
    lines += [f"left out: {line}" for line in report.missing]
    document = {"schema_version": 1, "page": str(report.path), "bytes": report.num_bytes, "scenes": report.scenes}
    return Outcome("\n".join(lines), document | {"video": {"side": side, "crf": crf}, "missing": list(report.missing)})
