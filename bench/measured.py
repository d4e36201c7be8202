"""The results of one or more runs over the same scenes and cameras, read from their files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from bench.codec import ALREADY_CODED
from bench.digest import broken_seals, is_sealed
from bench.record import FAILED, CellRecord, StoredFrame
from bench.store import RunStore
from bench.trajectories import first_difference
from orca.errors import BadInput

__all__ = ["COSTS", "FAIL", "MISSING", "Column", "Measured", "Value", "read_runs"]

FAIL, NOT_APPLICABLE, MISSING = "fail", "n/a", "-"


@dataclass(frozen=True)
class Column:
    """A column: a metric, or a cost."""

    key: str
    title: str
    decimals: int
    higher_is_better: bool | None
    variant: str = ""


COSTS = (
    Column("seconds", "s/scene", 1, False),
    Column("render_ms_per_frame", "ms/frame", 1, False),
    Column("anchors", "Anchors", 0, None),
)


@dataclass(frozen=True)
class Value:
    """A number, or the word that stands for it and the reason why."""

    number: float | None
    word: str = ""
    reason: str = ""


@dataclass(frozen=True)
class Measured:
    """Everything that a table shows.

    Attributes:
        dataset: name of the data set.
        scenes: in the data set's order.
        methods: row labels.
        columns: the metrics.
        records: (label, scene) -> result; a pair that was not run is absent.
        caption: command, preset, data set, machine, threads and date, a line each run; what the frames went through.
    """

    dataset: str
    scenes: tuple[str, ...]
    methods: tuple[str, ...]
    columns: tuple[Column, ...]
    records: Mapping[tuple[str, str], CellRecord]
    caption: tuple[str, ...]

    def value(self, method: str, scene: str, key: str) -> Value:
        """The number of a metric or a cost in one cell, or why there is none."""
        record = self.records.get((method, scene))
        if record is None:
            return Value(None, MISSING)
        if record.failure is not None:
            return Value(None, FAIL, record.failure.summary)
        if any(key == cost.key for cost in COSTS):
            return _cost(record, key)
        score = record.scores.get(key)
        if score is None:
            return Value(None, MISSING)
        if score.value is None:
            return Value(None, FAIL if score.status == FAILED else NOT_APPLICABLE, score.reason or "")
        return Value(score.value)

    def failed_scenes(self, method: str) -> int:
        """How many scenes the method, or one of the metrics on it, failed on."""
        return sum(self.records[method, scene].any_failed for scene in self.scenes if (method, scene) in self.records)


def read_runs(roots: Sequence[Path], slim: bool = False) -> Measured:
    """Read one or more run folders over the same data set; a method of several runs gets the folder's name.

    Args:
        roots: the folders.
        slim: leave out of the results what no table of means shows (values a frame, details of scores, hashes), which
            is nearly all of their memory.

    Raises:
        BadInput: no such run, another data set, other cameras for the same scene, one metric in two variants, or
            frames with and without codec matching.
    """
    stores = [RunStore(root) for root in roots]
    runs = [_run_document(store) for store in stores]
    datasets = [str(run["identity"]["dataset"]) for run in runs]
    _check_same(datasets, "runs over", "runs over one data set", "print them one by one")
    codecs = [str(run["identity"]["codec"]) for run in runs]
    _check_same(codecs, "frames with codec", "one treatment of frames", "bench compare sets two such runs side by side")
    records: dict[tuple[str, str], CellRecord] = {}
    methods: list[str] = []
    edited: list[Path] = []
    for store, run in zip(stores, runs, strict=True):
        others = {name for other in runs if other is not run for name in other["methods"]}
        labels = {name: f"{name} ({store.root.name})" if name in others else name for name in run["methods"]}
        methods += labels.values()
        listed, thin = set(run["scenes"]), _Thinner()
        for path, document in store.documents():
            record = CellRecord.from_json(document, str(path))
            if record.method in labels and record.scene in listed:
                records[labels[record.method], record.scene] = thin(record) if slim else record
                edited += [path] if is_sealed(document) and broken_seals(document) else []
    _check_cameras(records, stores)
    scenes = tuple(dict.fromkeys(scene for run in runs for scene in run["scenes"]))
    ids = dict.fromkeys(metric_id for run in runs for metric_id in run["metrics"])
    columns = tuple(_column(metric_id, records.values(), runs) for metric_id in ids)
    notes = (*_codec_notes(runs, records), *_version_notes(records), *_host_notes(records), *_edit_notes(edited))
    caption = (*map(_caption, runs), *notes)
    return Measured(datasets[0], scenes, tuple(methods), columns, records, caption)


class _Thinner:
    """Results without what no table of means shows; equal parts of several are one object in memory."""

    def __init__(self) -> None:
        self._known: dict[str, Any] = {}

    def __call__(self, record: CellRecord) -> CellRecord:
        scores = {
            key: replace(score, per_frame=None, detail={}, spec=self._one(score.spec))
            for key, score in record.scores.items()
        }
        frames = self._one([frame.index for frame in record.frames])
        return replace(
            record,
            scores=scores,
            frames=self._known.setdefault(f"frames {frames}", tuple(StoredFrame(i, "") for i in frames)),
            views={},
            inputs={},
            host=self._one(record.host),
        )

    def _one(self, value: Any) -> Any:
        return self._known.setdefault(repr(value), value)


def _check_same(values: Sequence[str], what: str, allowed: str, fix: str) -> None:
    if len(set(values)) > 1:
        raise BadInput(f"{what} {', '.join(values)}", f"{allowed} in one table", fix)


def _run_document(store: RunStore) -> dict[str, Any]:
    run = store.load_run()
    if run is None:
        raise BadInput(
            f"no run in '{store.root}'", "a folder that holds run.json", "make one: python -m bench run --out DIR"
        )
    return run


def _check_cameras(records: Mapping[tuple[str, str], CellRecord], stores: Sequence[RunStore]) -> None:
    """Results along other cameras are not comparable, so they do not share a table."""
    first: dict[str, tuple[str, CellRecord]] = {}
    for (label, scene), record in records.items():
        if record.trajectory_sha256 is None or record.failure is not None:
            continue
        other, before = first.setdefault(scene, (label, record))
        indices = [[frame.index for frame in r.frames] for r in (before, record)]
        if before.trajectory_sha256 != record.trajectory_sha256 or indices[0] != indices[1]:
            raise BadInput(
                f"scene {scene}: {other} and {label} have different cameras ({_where(before, record, stores)})",
                "one trajectory for a scene in one table",
                "run both methods again into a new --out",
            )


def _where(a: CellRecord, b: CellRecord, stores: Sequence[RunStore]) -> str:
    found = [
        next((t for store in stores if (t := store.load_trajectory(record.trajectory_sha256 or ""))), None)
        for record in (a, b)
    ]
    hashes = f"{str(a.trajectory_sha256)[:12]} and {str(b.trajectory_sha256)[:12]}"
    if found[0] is None or found[1] is None:
        return hashes
    frame = first_difference(found[0], found[1])
    return f"{hashes}; {'other evaluated frames' if frame is None else f'first differing frame: {frame}'}"


def _column(metric_id: str, records: Iterable[CellRecord], runs: Sequence[dict[str, Any]]) -> Column:
    specs = [record.scores[metric_id].spec for record in records if metric_id in record.scores]
    variants = sorted({str(spec["variant"]) for spec in specs})
    if len(variants) > 1:
        raise BadInput(
            f"metric {metric_id} in {len(variants)} variants: {'; '.join(variants)}",
            "one variant of a metric in one table",
            "run again with the same version of the bench into a new --out",
        )
    spec = specs[0] if specs else next(r["metric_specs"][metric_id] for r in runs if metric_id in r["metric_specs"])
    return Column(
        metric_id, str(spec["title"]), int(spec["decimals"]), bool(spec["higher_is_better"]), str(spec["variant"])
    )


def _cost(record: CellRecord, key: str) -> Value:
    if key == "anchors":
        anchors = record.model.get("anchors")
        return Value(None, NOT_APPLICABLE, "the method has no anchors") if anchors is None else Value(float(anchors))
    if key == "render_ms_per_frame":
        milliseconds = record.timing.get(key)
        untimed = Value(None, NOT_APPLICABLE, "frames were read, not rendered here")
        return untimed if milliseconds is None else Value(float(milliseconds))
    phases = record.timing.get("phases", {})
    return Value(sum(phases.values())) if phases else Value(None, NOT_APPLICABLE, "frames were read, not rendered here")


def _codec_notes(runs: Sequence[Mapping[str, Any]], records: Mapping[tuple[str, str], CellRecord]) -> list[str]:
    """Say what the frames of a matched run went through; a run without it says which methods' frames were coded."""
    codec = runs[0]["identity"]["codec"]
    coded = dict.fromkeys(label for (label, _), r in records.items() if r.codec == ALREADY_CODED)
    before = f"{', '.join(coded)}: {ALREADY_CODED}." if coded else ""
    if codec is None:
        return [f"Frames as rendered, no codec. {before}"] if coded else []
    return [f"Codec match: every method's frames went through {codec} before any metric. {before}".strip()]


def _host_notes(records: Mapping[tuple[str, str], CellRecord]) -> list[str]:
    """Seconds of several machines, or with several numbers of threads, are not those of one: said of such rows."""
    settings: dict[str, set[str]] = {}
    for (label, _), record in records.items():
        settings.setdefault(label, set()).add(_machine(record.host))
    mixed = sorted({machine for found in settings.values() if len(found) > 1 for machine in found})
    return [f"Timings are of {len(mixed)} settings: {'; '.join(mixed)}."] if mixed else []


def _machine(host: Mapping[str, Any]) -> str:
    return f"{host.get('cpu')}, {host.get('cores')} cores, {host.get('threads')} threads"


def _edit_notes(edited: Sequence[Path]) -> list[str]:
    """A table made of edited files must not look like one made of measured ones."""
    return [f"NOT AS MEASURED: {path} was changed after it was written (bench verify)" for path in edited]


def _version_notes(records: Mapping[tuple[str, str], CellRecord]) -> list[str]:
    """Say it where one row, or one column, mixes versions."""
    by_method: dict[str, set[str]] = {}
    by_metric: dict[str, set[str]] = {}
    for (label, _), record in records.items():
        by_method.setdefault(label, set()).add(record.method_version)
        for key, score in record.scores.items():
            by_metric.setdefault(key, set()).add(
                f"{score.spec.get('version')} {score.spec.get('weights_sha256') or ''}"
            )
    mixed = {**by_method, **by_metric}
    return [f"mixed versions of {name}: {'; '.join(sorted(found))}" for name, found in mixed.items() if len(found) > 1]


def _caption(run: Mapping[str, Any]) -> str:
    host, identity = run.get("host", {}), run["identity"]
    command = "; ".join(run.get("commands", [])) or "run_bench (as a library)"
    path = "" if identity.get("trajectory") is None else f", trajectory {identity['trajectory']}"
    return (
        f"{command}. Data set {identity['dataset']}{path}, preset {identity['preset']}, seed {identity['seed']}. "
        f"{host.get('cpu')}, {host.get('cores')} cores, {host.get('threads')} threads, {identity['device']}. "
        f"{str(run['timing'].get('started', ''))[:10]}."
    )
