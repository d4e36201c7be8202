"""A run: what is asked for is compared with what is there, and the rest is done scene by scene, wherever."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from bench.adapters import METHODS, Adapter
from bench.executors import Executor, InThisProcess
from bench.host import host_facts
from bench.metrics import METRICS, Metric
from bench.parquet import write_scores
from bench.plan import check_same_run, in_order
from bench.progress import Reporter, SilentReporter
from bench.provenance import code_state, data_block
from bench.record import SCHEMA_VERSION, CellRecord
from bench.request import RunRequest
from bench.scenework import SceneOutcome, SceneRunner, SceneWork, opened
from bench.store import RunStore
from orca.atomic import atomic_path, drop_unfinished
from orca.registry import Registry

__all__ = ["RunRequest", "RunSummary", "keep_summary", "run_bench"]


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
    executor: Executor | None = None,
) -> RunSummary:
    """Compute whatever of the request is not there yet.

    A scene is one task (`bench.scenework`), done by the executor: any executor goes on where any other stopped.

    Args:
        request: what to run.
        reporter: hears of the progress.
        methods, metrics: where names come from.
        executor: who does it; this process, one scene after another, if left out.

    Raises:
        Unknown: a method or metric that the registries do not know; raised before any work.
        BadInput: the folder holds another run, or its scenes had other cameras; two methods of one name.
        CannotWrite: the folder is read-only or full; what was finished stays.
    """
    work = SceneWork(request, methods, metrics)
    runner = opened(work)
    store = runner.store
    drop_unfinished(store.root)
    with store.alone():
        before = store.load_run()
        check_same_run(before, request.identity, request.out)
        store.save_run(_run_document(runner, before or {}, methods, metrics))
    told = reporter or SilentReporter()
    told.start(len(request.scenes) * len(runner.adapters))
    try:
        outcomes = _outcomes(work, runner, executor or InThisProcess(), told)
    finally:
        told.close()
    computed = sum(outcome.computed for outcome in outcomes.values())
    if computed or store.summary_is_stale():
        keep_summary(store)
    failed = tuple((method, scene) for scene in request.scenes for method in outcomes[scene].failed)
    return RunSummary(computed, len(request.scenes) * len(runner.adapters) - computed, failed)


def _outcomes(work: SceneWork, runner: SceneRunner, executor: Executor, told: Reporter) -> dict[str, SceneOutcome]:
    """How every scene went: those that are finished by their files, the others by the executor."""
    outcomes: dict[str, SceneOutcome] = {}
    left = []
    for scene in runner.request.scenes:
        finished = runner.finished(scene)
        if finished is None:
            left.append(scene)
            continue
        outcomes[scene] = finished
        for _ in runner.adapters:
            told.cell(None)
    if left:
        outcomes.update((outcome.scene, outcome) for outcome in executor.run(work, left, told))
    return outcomes


def keep_summary(store: RunStore) -> None:
    """Write what all results together say: what the scenes were made of into ``run.json``, and the long table.

    The table takes its name last: while it is older than a result, this is to be done again.
    """
    inputs: dict[str, dict[str, Any]] = {}

    def noted() -> Iterator[CellRecord]:
        for record in store.records():
            if record.inputs:
                inputs.setdefault(record.scene, record.inputs)
            yield record

    with store.alone(), atomic_path(store.summary_path) as table:
        write_scores(table, noted())
        made_of, run = data_block(inputs), store.load_run()
        if run is not None and run.get("data") != made_of:
            store.save_run({**run, "data": made_of})


def _run_document(
    runner: SceneRunner, old: dict[str, Any], methods: Iterable[str], metrics: Iterable[str]
) -> dict[str, Any]:
    """``run.json``: scenes, methods and metrics add up over the runs into one folder, in their registered order."""
    request, versions, specs = runner.request, runner.versions, runner.scorer.specs
    earlier = old.get("argv", [])
    commands = [*old.get("commands", []), *([request.command] if request.command else [])]
    return {
        "schema_version": SCHEMA_VERSION,
        "identity": request.identity,
        "scenes": in_order([*old.get("scenes", []), *request.scenes], request.dataset.scenes()),
        "methods": in_order([*old.get("methods", []), *versions], methods),
        "metrics": in_order([*old.get("metrics", []), *request.metrics], metrics),
        "method_versions": {**old.get("method_versions", {}), **versions},
        "metric_specs": {**old.get("metric_specs", {}), **specs},
        "preset_config": request.preset_config or old.get("preset_config", {}),
        "folders": {"data_root": request.options.data_root, "weights_dir": request.options.weights_dir},
        "commands": list(dict.fromkeys(commands)),
        "argv": [*earlier, *([list(request.argv)] if request.argv and list(request.argv) not in earlier else [])],
        "code": code_state(),
        "data": old.get("data", {}),
        "timing": {"started": datetime.now(UTC).isoformat(timespec="seconds"), **old.get("timing", {})},
        "host": host_facts(request.options.device),
    }
