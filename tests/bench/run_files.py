"""The files of a run, byte for byte, without what no two runs share; and what a run says took too long."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from bench.latex import latex_table
from bench.measured import COSTS, read_runs
from bench.pairs import pairs_table
from bench.request import RunRequest
from bench.store import RunStore
from bench.tables import dataset_table, scene_table

_VOLATILE = ("timing", "host")
# What was typed where, and the state of the code, are facts of a run too. The seal of run.json is over them.
_OF_THE_RUN = ("argv", "folders", "code", "digest")
_TIMED = ("seconds", "render_ms_per_frame")


def lasting(run: Path, also: tuple[str, ...] = (), ordered: bool = True) -> dict[str, bytes]:
    """Path -> content of every file below ``run`` but locks, as bytes (``also``: parts that are left out as well).

    Of a JSON object that has timing and host, these two parts are cut out of its text; everything else stays as it
    was written, order and layout included: a result keeps its seal, which is over the rest. Parquet is compared whole,
    it has no timing. Tables are made anew from the files, in all their forms, without their columns of seconds and
    their caption, which names machine, command and date.

    With ``ordered`` False keys of JSON and rows of Parquet are put in order first: what `bench merge` put together of
    two results has its keys sorted.
    """
    found = {}
    for path in sorted(p for p in run.rglob("*") if p.is_file()):
        name = path.relative_to(run)
        if name.parts[0] not in (".lock", "tables", *also):
            found[name.as_posix()] = _without_volatile(path, name.parts[0] == "run.json", ordered)
    return found | _tables(run)


def _without_volatile(path: Path, of_the_run: bool, ordered: bool) -> bytes:
    content = path.read_bytes()
    if path.suffix == ".parquet" and not ordered:
        return "\n".join(sorted(map(str, pq.read_table(path).to_pylist()))).encode()
    if path.suffix != ".json":
        return content
    document = json.loads(content)
    left_out = (*_VOLATILE, *(_OF_THE_RUN if of_the_run else ()))
    if not set(left_out) & set(document):
        return content
    assert _as_written(document) == content, f"{path} is not laid out as the store lays out JSON"
    return _as_written({key: value for key, value in document.items() if key not in left_out}, not ordered)


def _as_written(document: Any, sort_keys: bool = False) -> bytes:
    return (json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False, sort_keys=sort_keys) + "\n").encode()


def _tables(run: Path) -> dict[str, bytes]:
    measured = replace(read_runs([run]), caption=())
    columns = (*measured.columns, *(cost for cost in COSTS if cost.key not in _TIMED))
    made = {}
    for table in (dataset_table(measured, columns), scene_table(measured, columns), pairs_table(measured)):
        forms = {"md": table.to_markdown(), "tex": latex_table(table), "csv": table.to_csv()}
        forms["json"] = json.dumps(table.to_json())
        made |= {f"tables/{table.name}.{kind}": text.encode() for kind, text in forms.items()}
    return made


def timed_out(request: RunRequest) -> set[str]:
    """ "METHOD SCENE" of every cell that took too long, "METHOD SCENE METRIC" of every score that did."""
    found = set()
    for record in RunStore(request.out).records():
        cell = f"{record.method} {record.scene}"
        if record.failure is not None and record.failure.kind == "timed_out":
            found.add(cell)
        found |= {
            f"{cell} {key}" for key, score in record.scores.items() if str(score.reason).startswith("timed_out: ")
        }
    return found
