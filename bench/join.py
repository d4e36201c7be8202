"""The one result that two results of the same cell make: associative, commutative, idempotent, or a conflict.

Every part is a join of its own. What must be one thing (frames, inputs, values) is equal or a conflict; a success
stands above a failure, a value above none; of two equal ones that were measured twice, one is kept whole, by an order
of their contents and not of the runs. So no order of merging, and no repetition, makes a difference.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, TypeVar

from bench.digest import unsealed
from bench.plan import IDENTITY
from bench.record import FAILED, SCHEMA_VERSION, UNAVAILABLE, CellRecord, ScoreRecord, jsonable

__all__ = ["Conflict", "canonical", "joined_records", "joined_runs", "own_timing"]

T = TypeVar("T")

_SAME_CELL = ("dataset", "scene", "method", "method_version")
_SAME_RESULT = ("trajectory_sha256", "frames", "views", "codec", "model", "notes")
_WORTH = {UNAVAILABLE: 1, FAILED: 2}  # anything else is an answer


class Conflict(Exception):
    """Two results cannot both be right; the message says in what they differ."""


def canonical(value: Any) -> str:
    """Text that is equal for equal data: what "the smaller" of two means here."""
    return json.dumps(jsonable(value), sort_keys=True, ensure_ascii=False, separators=(",", ":"))


def own_timing(record: CellRecord) -> dict[str, Any]:
    """How long the method took, and on what machine: which of several runs a result comes from."""
    timing = {key: value for key, value in unsealed({"timing": record.timing})["timing"].items() if key != "metrics"}
    return {"timing": timing, "host": record.host}


def joined_records(a: CellRecord, b: CellRecord) -> CellRecord:
    """The result that both say together. Raises `Conflict`."""
    _same(a, b, _SAME_CELL)
    if a.failure is not None or b.failure is not None:
        return min((a, b), key=lambda record: (record.failure is not None, canonical(record.to_json())))
    _same(a, b, _SAME_RESULT)
    kept = min((own_timing(a), own_timing(b)), key=canonical)
    seconds = _union(a.timing.get("metrics", {}), b.timing.get("metrics", {}), lambda key, x, y: min(x, y))
    return replace(
        a,
        inputs=_union(a.inputs, b.inputs, _joined_inputs),
        scores=_union(a.scores, b.scores, _joined_scores),
        timing={**kept["timing"], "metrics": seconds},
        host=kept["host"],
    )


def joined_runs(a: Mapping[str, Any], b: Mapping[str, Any]) -> dict[str, Any]:
    """The ``run.json`` of both, in `bench.store.RunStore.load_run`'s form. Raises `Conflict`.

    Lists of names come out sorted; what order they belong in, only the data set and the registries know.
    """
    for field in IDENTITY:
        if a["identity"].get(field) != b["identity"].get(field):
            raise Conflict(f"{field} {a['identity'].get(field)} and {b['identity'].get(field)}")
    presets = [run["preset_config"] for run in (a, b) if run.get("preset_config")]
    if any(preset != presets[0] for preset in presets):
        raise Conflict(f"other constants of preset {a['identity'].get('preset')}")

    started = [run["timing"]["started"] for run in (a, b) if run.get("timing", {}).get("started")]

    def listed(key: str) -> list[Any]:
        both = [*a.get(key, []), *b.get(key, [])]
        return [json.loads(text) for text in sorted({canonical(item) for item in both})]

    def smaller(key: str) -> Any:
        return min(a.get(key, {}), b.get(key, {}), key=lambda value: (not value, canonical(value)))

    def by_name(key: str) -> dict[str, Any]:
        return _union(a.get(key, {}), b.get(key, {}), lambda _, x, y: min(x, y, key=canonical))

    return {
        "schema_version": SCHEMA_VERSION,
        "identity": dict(a["identity"]),
        **{key: listed(key) for key in ("scenes", "methods", "metrics")},
        **{key: by_name(key) for key in ("method_versions", "metric_specs")},
        "preset_config": presets[0] if presets else {},
        "folders": smaller("folders"),
        **{key: listed(key) for key in ("commands", "argv")},
        "code": smaller("code"),
        "data": {},  # of the results, once they are together
        "timing": {"started": min(started)} if started else {},
        "host": smaller("host"),
    }


def _joined_scores(key: str, a: ScoreRecord, b: ScoreRecord) -> ScoreRecord:
    worth = [_WORTH.get(score.status, 0) for score in (a, b)]
    if worth == [0, 0] and canonical(a) != canonical(b):
        raise Conflict(f"{key} {_shown(a)} and {_shown(b)}")
    return min((a, b), key=lambda score: (_WORTH.get(score.status, 0), canonical(score)))


def _shown(score: ScoreRecord) -> str:
    value = score.reason if score.value is None else repr(score.value)
    return f"{value} ({score.spec.get('variant')}, version {score.spec.get('version')}, n {score.n})"


def _joined_inputs(key: str, a: Any, b: Any) -> Any:
    """Hashes of what was decoded are one thing; which files lay there may differ, but not their contents."""
    if key == "files":
        return _union(a, b, _joined_inputs)
    if a != b:
        raise Conflict(f"another {key} as input")
    return a


def _union(a: Mapping[str, T], b: Mapping[str, T], both: Callable[[str, T, T], T]) -> dict[str, T]:
    """All keys, sorted; a value of either, or what ``both`` makes of two."""
    return {
        key: both(key, a[key], b[key]) if key in a and key in b else (a[key] if key in a else b[key])
        for key in sorted({*a, *b})
    }


def _same(a: CellRecord, b: CellRecord, fields: tuple[str, ...]) -> None:
    for name in fields:
        if getattr(a, name) != getattr(b, name):
            shown = [str(getattr(record, name)) for record in (a, b)]
            raise Conflict(f"another {name}" + (f": {shown[0]} and {shown[1]}" if sum(map(len, shown)) < 200 else ""))
