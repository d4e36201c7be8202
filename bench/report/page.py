"""Puts the page together: data, media, template, style and script into one file."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib import resources
from pathlib import Path
from typing import Any

from bench.measured import Column, Measured, read_runs
from bench.report.charts import chart_data
from bench.report.collect import MORE_COSTS, Sources, as_script, collect_scenes, problems, shown_columns
from bench.report.media import RUNGS, Media
from bench.report.stability import find_stability, read_stability
from bench.store import RunStore, write_atomic
from bench.tableformat import Table
from bench.tables import dataset_table
from orca.errors import BadInput

__all__ = ["Report", "write_report"]


@dataclass(frozen=True)
class Report:
    """What was written: where, how large, and what the page had to leave out."""

    path: Path
    num_bytes: int
    scenes: int
    video: tuple[int, int]
    missing: tuple[str, ...]


def write_report(
    root: Path,
    out: Path,
    data_root: Path | None = None,
    stability: Path | None = None,
    max_bytes: int = 30_000_000,
    progress: Callable[[str], None] = lambda line: None,
) -> Report:
    """Write the page of one run.

    Videos are as large as the page's size allows: the steps of `RUNGS` are tried in order, judged by the first scene.

    Args:
        root: folder of the run.
        out: file to write.
        data_root: where the data set lies now; where it lay then when left out.
        stability: a stability JSON; one that lies beside the run when left out.
        max_bytes: size that the page must not exceed.
        progress: told what is being done.

    Raises:
        BadInput: no run, a broken stability JSON, or a run too large for a page even with the smallest videos.
    """
    measured, store = read_runs([root]), RunStore(root)
    run = store.load_run() or {}
    found = stability or find_stability(Path(root))
    matrix = None if found is None else read_stability(found)
    size = None
    for rung in RUNGS:
        progress(f"videos of {rung[0]} pixels, rate factor {rung[1]}")
        if rung != RUNGS[-1] and not _likely_fits(measured, Sources(store, run, data_root, rung), max_bytes):
            continue
        media, sources = Media(), Sources(store, run, data_root, rung)
        page = _page(measured, collect_scenes(measured, sources, media), media, sources, matrix).encode()
        size = len(page)
        if size <= max_bytes:
            write_atomic(Path(out), page)
            return Report(Path(out), size, len(measured.scenes), rung, tuple(sources.missing))
    raise BadInput(
        f"a page of {size or 0:,} bytes with the smallest videos",
        f"at most {max_bytes:,} bytes",
        "report on fewer scenes, or raise --max-mb",
    )


def _likely_fits(run: Measured, sources: Sources, max_bytes: int) -> bool:
    """Whether the first scene's share of the page leaves room for the others."""
    from dataclasses import replace

    media = Media()
    collect_scenes(replace(run, scenes=run.scenes[:1]), sources, media)
    return sum(len(content) for _, content in media.items) * len(run.scenes) <= 0.95 * max_bytes


def _page(
    run: Measured, scenes: list[dict[str, Any]], media: Media, sources: Sources, matrix: dict[str, Any] | None
) -> str:
    import jinja2

    style, script = _asset("page.css"), _asset("page.js")
    environment = jinja2.Environment(
        autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    )
    columns = shown_columns(run)
    return environment.from_string(_asset("page.html.j2")).render(
        title=f"{run.dataset}, {_count(len(run.methods), 'method')} on {_count(len(run.scenes), 'scene')}",
        run=run,
        table=_heads(dataset_table(run, [c for c in columns if c not in MORE_COSTS]), columns),
        data=as_script(_document(run, columns, scenes)),
        media=media.items,
        matrix=matrix,
        problems=problems(run),
        missing=sources.missing,
        provenance=_provenance(sources.run),
        written=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        style=style,
        script=script,
        style_hash=_csp_hash(style),
        script_hash=_csp_hash(script),
    )


def _document(run: Measured, columns: tuple[Column, ...], scenes: list[dict[str, Any]]) -> dict[str, Any]:
    """What the script needs."""
    return {
        "methods": run.methods,
        "columns": [
            {
                "key": c.key,
                "title": c.title,
                "decimals": c.decimals,
                "higher": c.higher_is_better,
            }
            for c in columns
        ],
        "chart": chart_data(run),
        "scenes": scenes,
    }


def _heads(table: Table, columns: tuple[Column, ...]) -> dict[str, Any]:
    """The table of means, with which way each column is sorted first; footnote marks belong to the printed table."""
    better = {column.key: column.higher_is_better for column in columns}
    rows = [
        {"label": row.labels[0], "cells": [(re.sub(r" \[[\d,]+\]", "", cell.text), cell) for cell in row.cells]}
        for row in table.rows
    ]
    heads = [
        {
            "title": h.title.replace(" ↑", "\u00a0↑").replace(" ↓", "\u00a0↓"),
            "first": "descending" if better.get(h.key) else "ascending",
        }
        for h in table.heads
    ]
    return {"title": table.title, "heads": heads, "rows": rows, "notes": [n for n in table.notes if n[:1] != "["]}


def _provenance(run: dict[str, Any]) -> list[tuple[str, list[str]]]:
    """Headings and lines of the footer."""
    host, identity, code = run.get("host", {}), run.get("identity", {}), run.get("code") or {}
    started = run.get("timing", {}).get("started", "?")
    specs = run.get("metric_specs", {}).values()
    machine = [f"{key}: {value}" for key, value in host.items() if key != "versions"]
    versions = [f"{name} {version}" for name, version in host.get("versions", {}).items() if version]
    return [
        (
            "Commands",
            [*(str(command) for command in run.get("commands", [])), f"started {started}"],
        ),
        ("Run", [f"{key}: {value}" for key, value in identity.items() if value is not None]),
        ("Code", [f"{key}: {value}" for key, value in code.items() if value is not None]),
        ("Machine", machine),
        ("Libraries", versions),
        ("Methods", [f"{name}: {version}" for name, version in run.get("method_versions", {}).items()]),
        ("Metrics", [f"{spec['title']}: {spec['variant']} ({spec['version']})" for spec in specs]),
    ]


def _count(n: int, word: str) -> str:
    return f"{n} {word}" + ("" if n == 1 else "s")


def _asset(name: str) -> str:
    return resources.files("bench.report").joinpath(name).read_text(encoding="utf-8")


def _csp_hash(text: str) -> str:
    """The hash by which the page's policy knows its own style and script, and nothing else."""
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
