"""``bench stability --curves``: quality against disturbance, and the spread over seeds."""

from __future__ import annotations

import argparse
from pathlib import Path

from bench.commands.names import chosen
from bench.commands.outcome import Outcome
from bench.progress import BarReporter
from bench.stability.curvechart import curves_text, write_curves
from bench.stability.curves import check_scene, run_curves, seed_spread
from bench.stability.disturb import DISTURBANCES
from bench.stability.outcome import FINISHED
from bench.stability.worker import Limits

__all__ = ["curves_outcome"]


def curves_outcome(args: argparse.Namespace, methods: tuple[str, ...], limits: Limits) -> Outcome:
    """Compute what is missing of the curves; exit code 1 where a point could not be computed.

    Raises:
        Unknown: no such disturbance or scene.
        BadInput: a scene without true views, or a folder with the curves of another one.
    """
    check_scene(args.scene)
    kinds = chosen("disturbance", None if args.curves == "all" else [args.curves], DISTURBANCES, DISTURBANCES)
    out = args.out or Path("runs") / "stability"
    stored = run_curves(kinds, methods, out, limits, args.preset, BarReporter(), args.scene)
    files = (stored.path, *write_curves(stored.rows(), out))
    rows = [row for row in stored.rows() if row["disturbance"] in kinds and row["method"] in methods]
    missing = [row for row in rows if row["outcome"] not in FINISHED]
    spreads = {method: seed_spread(rows, method) for method in methods}
    document = {
        "schema_version": 1,
        "rows": rows,
        "seed_standard_deviation": spreads,
        "files": [str(path) for path in files],
    }
    text = "\n".join([curves_text(rows), *(f"wrote {path}" for path in files)])
    return Outcome(text, document, 1 if missing else 0)
