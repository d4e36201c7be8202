"""What a run leaves behind for one method on one scene, as plain data."""

from __future__ import annotations

import dataclasses
import math
import traceback
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import PurePath
from typing import Any

import numpy as np

from bench.digest import sealed, unsealed
from bench.metrics.metric import MetricSpec, Score
from orca.errors import BadInput, OrcaError

__all__ = ["FAILED", "READABLE", "SCHEMA_VERSION", "CellRecord", "Failure", "ScoreRecord", "StoredFrame", "jsonable"]

READABLE = (1, 2)
SCHEMA_VERSION = 2  # 2: inputs, views, codec and the seal of `bench.digest`

OK, NOT_APPLICABLE, UNAVAILABLE, FAILED = "ok", "not_applicable", "unavailable", "failed"


def jsonable(value: Any) -> Any:
    """Plain JSON data for ``value``: numpy becomes lists and numbers, NaN becomes null, infinities the words "inf".

    JSON has no NaN and no infinity, and other readers than Python's refuse them.
    """
    if isinstance(value, np.ndarray):
        return jsonable(value.tolist())
    if isinstance(value, np.generic):
        return jsonable(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else ("inf" if value > 0 else "-inf")
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return jsonable(asdict(value))
    if isinstance(value, Mapping):
        return {str(key): jsonable(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [jsonable(item) for item in value]
    if isinstance(value, PurePath):
        return str(value)
    return value


@dataclass(frozen=True)
class Failure:
    """Why there is no result.

    Attributes:
        kind: the `OrcaError.kind` of an expected failure, "out_of_memory", or "crash".
        message: given / allowed / fix, in words.
        phase: what was being done ("load", "method").
        traceback: of what was not expected.
    """

    kind: str
    message: dict[str, str]
    phase: str
    traceback: str | None = None

    @staticmethod
    def of(error: Exception, phase: str) -> Failure:
        """The typed record of an exception; anything but an `OrcaError` is a crash and keeps its traceback."""
        if isinstance(error, OrcaError):
            return Failure(error.kind, {"given": error.given, "allowed": error.allowed, "fix": error.fix}, phase)
        if _out_of_memory(error):
            message = {
                "given": f"out of memory: {error}",
                "allowed": "what fits into the memory of this machine",
                "fix": "a smaller image or preset, fewer --jobs, or more memory; then rerun with --retry-failed",
            }
            return Failure("out_of_memory", message, phase, "".join(traceback.format_exception(error)))
        message = {
            "given": f"{type(error).__name__}: {error}",
            "allowed": "a method that returns frames or raises an OrcaError",
            "fix": "read the traceback in this record; rerun with --retry-failed once it is mended",
        }
        return Failure("crash", message, phase, "".join(traceback.format_exception(error)))

    @property
    def summary(self) -> str:
        """One line for a table's footnote."""
        return f"{self.kind} in {self.phase}: {' '.join(self.message.get('given', '').split())}"


def _out_of_memory(error: Exception) -> bool:
    """Python's and numpy's own error, and how torch and OpenCV say the same."""
    words = ("can't allocate memory", "Insufficient memory")
    named = isinstance(error, MemoryError) or type(error).__name__ == "OutOfMemoryError"
    return named or any(word in str(error) for word in words)


@dataclass(frozen=True)
class ScoreRecord:
    """A `Score` at rest, with the spec that made it.

    Attributes:
        value, n, reason, per_frame, detail: as in `Score`.
        status: "ok"; "not_applicable" (the metric says so); "unavailable" (weights or packages are missing);
            "failed" (the metric raised or returned nonsense).
        spec: the `MetricSpec` as plain data.
    """

    value: float | None
    n: int
    reason: str | None
    status: str
    spec: dict[str, Any]
    per_frame: list[float | None] | None = None
    detail: dict[str, Any] = field(default_factory=dict)

    @staticmethod
    def of(score: Score, spec: MetricSpec) -> ScoreRecord:
        """Store a score; a value that is not finite, or none without a reason, is a failure of the metric."""
        plain = jsonable(asdict(spec))
        if score.value is not None and not math.isfinite(score.value):
            return ScoreRecord(None, score.n, f"the metric returned {score.value}", FAILED, plain)
        if score.value is None and not score.reason:
            return ScoreRecord(None, score.n, "the metric gave neither a value nor a reason", FAILED, plain)
        status = NOT_APPLICABLE if score.value is None else OK
        value = None if score.value is None else float(score.value)
        per_frame = None if score.per_frame is None else jsonable(score.per_frame)
        return ScoreRecord(value, int(score.n), score.reason, status, plain, per_frame, jsonable(score.detail))

    @staticmethod
    def without_value(spec: MetricSpec, error: Exception) -> ScoreRecord:
        """Store why a metric has no value: unavailable, or failed with its traceback."""
        plain = jsonable(asdict(spec))
        failure = Failure.of(error, "metric")
        given = " ".join(failure.message["given"].split())
        if failure.kind == "unavailable":
            fix = " ".join(failure.message["fix"].split())
            return ScoreRecord(None, 0, f"{given}; {fix}", UNAVAILABLE, plain)
        detail = {} if failure.traceback is None else {"traceback": failure.traceback}
        return ScoreRecord(None, 0, f"{failure.kind}: {given}", FAILED, plain, detail=detail)

    def made_by(self, spec: MetricSpec) -> bool:
        """True if ``spec`` would compute the same number (its title and digits may differ)."""
        return all(self.spec.get(key) == getattr(spec, key) for key in ("id", "variant", "version", "weights_sha256"))


@dataclass(frozen=True)
class StoredFrame:
    """An evaluated frame: its index in the trajectory and the SHA-256 of its decoded RGB pixels."""

    index: int
    pixel_sha256: str


def _checked(record: CellRecord) -> CellRecord:
    """The record, if its parts are of the types that everybody reads them as; raises `TypeError` otherwise."""
    words = (record.dataset, record.scene, record.method, record.method_version, *record.notes)
    tables = (record.timing, record.host, record.model, record.views, record.inputs)
    if not all(isinstance(word, str) for word in words) or not all(isinstance(part, dict) for part in tables):
        raise TypeError("a name that is no text, or a part that is no object")
    if not all(isinstance(word, str | None) for word in (record.trajectory_sha256, record.codec)):
        raise TypeError("a hash or a codec that is no text")
    if any(type(frame.index) is not int or not isinstance(frame.pixel_sha256, str) for frame in record.frames):
        raise TypeError("a frame without a number or a hash")
    files, seconds = record.inputs.get("files", {}), record.timing.get("metrics", {})
    if not isinstance(files, dict) or not isinstance(seconds, dict):
        raise TypeError("files or seconds that are no object")
    if not all(isinstance(second, int | float) for second in seconds.values()):
        raise TypeError("seconds that are no number")
    for key, score in record.scores.items():
        number = score.value is None or (isinstance(score.value, int | float) and not isinstance(score.value, bool))
        if not number or type(score.n) is not int or not isinstance(score.spec, dict):
            raise TypeError(f"a score '{key}' without a number")
        if score.status not in (OK, NOT_APPLICABLE, UNAVAILABLE, FAILED):
            raise ValueError(f"a score '{key}' of status {score.status}")
        if not isinstance(score.per_frame, list | None) or not isinstance(score.detail, dict):
            raise TypeError(f"a score '{key}' whose values are no list")
    return record


@dataclass(frozen=True)
class CellRecord:
    """One method on one scene.

    Attributes:
        dataset, scene, method: which cell.
        method_version: `Adapter.version` when it ran.
        trajectory_sha256: hash of the full path; None when the scene could not be loaded.
        scores: metric id -> score; empty for a failure.
        frames: the evaluated frames, in order, as they were scored.
        views: hashes of the method's other views and coverage (`bench.provenance.output_hashes`).
        inputs: hashes of what the method was given (`bench.provenance.case_hashes`), and under "files" those of the
            files that it came from; empty in a result of schema version 1.
        codec: what the frames went through before they were scored; None for nothing.
        timing: "phases" (seconds, as the method gave them), "wall_s" (the whole call), "load_s",
            "render_ms_per_frame", "memory" (as `bench.memory` measures it), "metrics" (seconds per metric family).
        host: machine facts of `bench.host`.
        model: size and make of the model, as the method gave it.
        notes: what a reader must know.
        failure: why there is no result, or None.
    """

    dataset: str
    scene: str
    method: str
    method_version: str
    trajectory_sha256: str | None
    scores: dict[str, ScoreRecord] = field(default_factory=dict)
    frames: tuple[StoredFrame, ...] = ()
    views: dict[str, str] = field(default_factory=dict)
    inputs: dict[str, Any] = field(default_factory=dict)
    codec: str | None = None
    timing: dict[str, Any] = field(default_factory=dict)
    host: dict[str, Any] = field(default_factory=dict)
    model: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    failure: Failure | None = None
    schema_version: int = SCHEMA_VERSION

    @property
    def any_failed(self) -> bool:
        """True if the method, or one of the metrics, failed."""
        return self.failure is not None or any(score.status == FAILED for score in self.scores.values())

    def to_json(self) -> dict[str, Any]:
        """Plain data under a seal, readable by `from_json`."""
        document = jsonable(asdict(self))
        if not isinstance(document, dict):
            raise TypeError("a record is a JSON object")
        return sealed({"schema_version": document.pop("schema_version"), **document})

    @staticmethod
    def from_json(document: dict[str, Any], source: str) -> CellRecord:
        """Read what `to_json` wrote, now or in an older schema version; the seal is `bench verify`'s affair.

        ``source`` names the file in the `BadInput` of a broken one.
        """
        try:
            if document["schema_version"] not in READABLE:
                raise ValueError(f"schema_version {document['schema_version']}")
            failure = document.get("failure")
            return _checked(
                CellRecord(
                    **{
                        **unsealed(document),
                        "schema_version": SCHEMA_VERSION,
                        "scores": {key: ScoreRecord(**score) for key, score in document["scores"].items()},
                        "frames": tuple(StoredFrame(**frame) for frame in document["frames"]),
                        "notes": tuple(document["notes"]),
                        "failure": None if failure is None else Failure(**failure),
                    }
                )
            )
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise BadInput(
                f"{source} is not a result of this bench ({type(error).__name__}: {error})",
                f"a JSON object of schema_version {' or '.join(map(str, READABLE))}, as bench run writes it",
                "delete the file and run again, or choose another --out",
            ) from error
