"""Every score of a run in one long table: a row for each scene's score, and one for each frame's."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from bench.record import CellRecord, ScoreRecord

__all__ = ["COLUMNS", "long_rows", "write_scores"]

_GROUP = 20_000  # rows that are held at a time

# Name -> Arrow type. `frame` counts within the score (frames, pairs or views), null on the row of the scene's score;
# `frame_index` and `pixel_sha256` are known where a score has a value for each evaluated frame.
COLUMNS = {
    "dataset": "string",
    "scene": "string",
    "method": "string",
    "method_version": "string",
    "metric": "string",
    "frame": "int32",
    "frame_index": "int32",
    "value": "float64",
    "n": "int32",
    "status": "string",
    "reason": "string",
    "variant": "string",
    "version": "string",
    "weights_sha256": "string",
    "trajectory_sha256": "string",
    "pixel_sha256": "string",
    "codec": "string",
}


def long_rows(record: CellRecord) -> Iterator[dict[str, Any]]:
    """Rows of one cell; a failed method gives one row without a metric, its status "failed"."""
    common: dict[str, Any] = dict.fromkeys(COLUMNS)
    for name in ("dataset", "scene", "method", "method_version", "trajectory_sha256", "codec"):
        common[name] = getattr(record, name)
    if record.failure is not None:
        yield common | {"status": "failed", "reason": record.failure.summary}
    for metric_id, score in record.scores.items():
        yield from _score_rows(record, score, common | {"metric": metric_id})


def _score_rows(record: CellRecord, score: ScoreRecord, common: dict[str, Any]) -> Iterator[dict[str, Any]]:
    made = {key: score.spec.get(key) for key in ("variant", "version", "weights_sha256")}
    yield common | made | {"value": score.value, "n": score.n, "status": score.status, "reason": score.reason}
    values = score.per_frame or []
    frames = record.frames if len(values) == len(record.frames) else (None,) * len(values)
    for i, (value, frame) in enumerate(zip(values, frames, strict=True)):
        known = {} if frame is None else {"frame_index": frame.index, "pixel_sha256": frame.pixel_sha256}
        number = float(value) if value is not None else None  # "inf", as `jsonable` writes it, is a number too
        yield common | made | known | {"frame": i, "value": number, "status": score.status}


def write_scores(path: Path, records: Iterable[CellRecord]) -> None:
    """Write the long table of these results as Parquet, some of them at a time in memory; not atomically."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    schema = pa.schema([(name, getattr(pa, kind)()) for name, kind in COLUMNS.items()])
    with pq.ParquetWriter(path, schema, compression="zstd") as writer:
        for rows in _groups(records):
            columns = {name: [row[name] for row in rows] for name in COLUMNS}
            writer.write_table(pa.table(columns, schema=schema))


def _groups(records: Iterable[CellRecord]) -> Iterator[list[dict[str, Any]]]:
    """Rows of the results in groups of some thousand."""
    rows: list[dict[str, Any]] = []
    for record in records:
        rows += long_rows(record)
        if len(rows) >= _GROUP:
            yield rows
            rows = []
    if rows:
        yield rows
