"""One (method, scene) at a time, written as soon as it is known, and never computed twice."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from bench.adapters import METHODS, Adapter, RunOptions, open_methods
from bench.cell import Cell, LazyCase
from bench.codec import CODEC
from bench.datasets.case import Dataset
from bench.host import host_facts
from bench.metrics import METRICS, Metric, MetricOptions
from bench.parquet import write_scores
from bench.plan import IDENTITY, check_same_run
from bench.progress import Reporter, SilentReporter
from bench.provenance import code_state, data_block
from bench.record import SCHEMA_VERSION, CellRecord
from bench.scorecache import ScoreCache
from bench.scoring import Scorer
from bench.store import RunStore
from orca.atomic import drop_unfinished
from orca.registry import Registry

__all__ = ["RunRequest", "RunSummary", "keep_summary", "run_bench"]


@dataclass(frozen=True)
class RunRequest:
    """What to run.

    Attributes:
        dataset: where the scenes come from.
        scenes: names, in running order; each must be one of ``dataset.scenes()``.
        methods: method names, or ``NAME=KIND:PATH`` (`bench.adapters.external`).
        metrics: metric ids.
        out: folder of the run.
        options: preset, seed, device and folders, as adapters see them.
        images: folder of images, for the data set that needs one.
        trajectory: name of the path, or None for the data set's own.
        retry_failed: run what failed again.
        command: the command line, for the caption.
        preset_config: the resolved preset, kept beside the results.
        argv: the command line as it was given, word by word.
        codec_match: score every method's pictures after `bench.codec`.
        score_cache: folder of scores by content; None for the run's own.
        metric_options: what the user chose about metrics; the file of answers is the run's own.
        cell_timeout: seconds that loading a scene, a method, and each metric family may take; None for no limit.
    """

    dataset: Dataset
    scenes: tuple[str, ...]
    methods: tuple[str, ...]
    metrics: tuple[str, ...]
    out: Path
    options: RunOptions = field(default_factory=RunOptions)
    images: Path | None = None
    trajectory: str | None = None
    retry_failed: bool = False
    command: str = ""
    preset_config: dict[str, Any] = field(default_factory=dict)
    argv: tuple[str, ...] = ()
    codec_match: bool = False
    score_cache: Path | None = None
    metric_options: MetricOptions = field(default_factory=MetricOptions)
    cell_timeout: float | None = None

    @property
    def identity(self) -> dict[str, Any]:
        """What may not change between two runs into one folder."""
        values = {
            "dataset": self.dataset.name,
            "images": None if self.images is None else str(Path(self.images).resolve()),
            "trajectory": self.trajectory,
            "preset": self.options.preset,
            "seed": self.options.seed,
            "device": self.options.device,
            "codec": CODEC if self.codec_match else None,
        }
        return {name: values[name] for name in IDENTITY}


@dataclass(frozen=True)
class RunSummary:
    """How a run went.

    Attributes:
        computed: cells in which something was computed.
        skipped: cells that were finished before.
        failed: (method, scene) of every cell asked for whose method or one of whose metrics failed, now or before.
    """

    computed: int
    skipped: int
    failed: tuple[tuple[str, str], ...]


def run_bench(
    request: RunRequest,
    reporter: Reporter | None = None,
    methods: Registry[Adapter] = METHODS,
    metrics: Registry[type[Metric]] = METRICS,
) -> RunSummary:
    """Compute whatever of the request is not there yet.

    Scenes are the outer loop (each is loaded once, and only if it has work), methods the inner. A cell is written after
    its method and again after each metric family, so a kill costs one metric at most.

    Raises:
        Unknown: a method or metric that the registries do not know; raised before any work.
        BadInput: the folder holds another run, or its scenes had other cameras; two methods of one name.
        CannotWrite: the folder is read-only or full; what was finished stays.
    """
    adapters = open_methods(request.methods, methods)
    store = RunStore(request.out)
    drop_unfinished(store.root)
    cache = ScoreCache(request.score_cache or store.root / "cache" / "scores")
    chosen = replace(request.metric_options, answers=store.root / "answers" / "llava.jsonl")
    scorer = Scorer(request.metrics, metrics, request.options.weights_dir, request.options.device, cache, chosen)
    check_same_run(store.load_run(), request.identity, request.out)
    versions = {name: adapter.version(request.options) for name, adapter in adapters.items()}
    order: dict[str, Iterable[str]] = {"scenes": request.dataset.scenes(), "methods": methods, "metrics": metrics}
    store.save_run(_run_document(request, store.load_run() or {}, versions, scorer, order))
    told = reporter or SilentReporter()
    told.start(len(request.scenes) * len(adapters))
    computed, failed = 0, []
    try:
        for scene in request.scenes:
            case = LazyCase(request.dataset, scene)
            for name, adapter in adapters.items():
                worked, record = Cell(
                    dataset=request.dataset.name,
                    case=case,
                    name=name,
                    adapter=adapter,
                    version=versions[name],
                    options=request.options,
                    store=store,
                    scorer=scorer,
                    reporter=told,
                    retry_failed=request.retry_failed,
                    codec_match=request.codec_match,
                    folders=(request.options.data_root, request.images),
                    timeout=request.cell_timeout,
                ).finish()
                computed += worked
                if _failed(record, scorer):
                    failed.append((name, scene))
    finally:
        told.close()
    if computed or store.summary_is_stale():
        keep_summary(store)
    return RunSummary(computed, len(request.scenes) * len(adapters) - computed, tuple(failed))


def keep_summary(store: RunStore) -> None:
    """Write what all results together say: what the scenes were made of into ``run.json``, and the long table."""
    records = list(store.records())
    run = store.load_run()
    made_of = data_block({r.scene: r.inputs for r in reversed(records) if r.inputs})
    if run is not None and run.get("data") != made_of:
        store.save_run({**run, "data": made_of})
    write_scores(store.summary_path, records)


def _failed(record: CellRecord, scorer: Scorer) -> bool:
    asked = replace(record, scores={key: score for key, score in record.scores.items() if key in scorer.ids})
    return asked.any_failed


def _run_document(
    request: RunRequest, old: dict[str, Any], versions: dict[str, str], scorer: Scorer, order: dict[str, Iterable[str]]
) -> dict[str, Any]:
    """``run.json``: scenes, methods and metrics add up over the runs into one folder, in their registered order."""

    def added(key: str, new: tuple[str, ...]) -> list[str]:
        together = set(old.get(key, [])) | set(new)
        known = [name for name in order[key] if name in together]
        return known + sorted(together - set(known))

    earlier = old.get("argv", [])
    commands = [*old.get("commands", []), *([request.command] if request.command else [])]
    return {
        "schema_version": SCHEMA_VERSION,
        "identity": request.identity,
        "scenes": added("scenes", request.scenes),
        "methods": added("methods", tuple(versions)),
        "metrics": added("metrics", request.metrics),
        "method_versions": {**old.get("method_versions", {}), **versions},
        "metric_specs": {**old.get("metric_specs", {}), **scorer.specs},
        "preset_config": request.preset_config or old.get("preset_config", {}),
        "folders": {"data_root": request.options.data_root, "weights_dir": request.options.weights_dir},
        "commands": list(dict.fromkeys(commands)),
        "argv": [*earlier, *([list(request.argv)] if request.argv and list(request.argv) not in earlier else [])],
        "code": code_state(),
        "data": old.get("data", {}),
        "timing": {"started": datetime.now(UTC).isoformat(timespec="seconds"), **old.get("timing", {})},
        "host": host_facts(request.options.device),
    }
