"""One scene is one task: what a process, here or on another machine, needs to finish it, and what it hands back.

Results go through the run's own files, written atomically; what is handed back only says how it went. So any process
that sees the folder may do any scene, and it does not matter which did.
"""

from __future__ import annotations

import os
import platform
import uuid
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from bench.adapters import Adapter, open_methods
from bench.cell import Cell, LazyCase
from bench.host import host_facts
from bench.metrics.metric import Metric
from bench.plan import Work, work_left
from bench.progress import Reporter, SilentReporter
from bench.provenance import FileListing
from bench.record import CellRecord, Failure
from bench.request import RunRequest
from bench.scorecache import ScoreCache
from bench.scoring import Scorer
from bench.store import RunStore
from orca.errors import BadInput, OrcaError
from orca.registry import Registry

__all__ = ["CellLeft", "LostWorker", "SceneOutcome", "SceneRunner", "SceneWork", "finish_scene", "opened"]


class LostWorker(OrcaError):
    """The process that worked on a scene is gone: killed, out of memory, or its machine went away."""

    kind = "lost_worker"


@dataclass(frozen=True)
class SceneOutcome:
    """How one scene went.

    Attributes:
        scene: its name.
        computed: cells in which something was computed.
        failed: methods that failed, or one of whose metrics did, now or before.
        lines: what was said of each cell, for executors without a line to the one who waits.
    """

    scene: str
    computed: int
    failed: tuple[str, ...]
    lines: tuple[str, ...] = ()


class CellLeft(NamedTuple):
    """The next step that a scene needs: a method, or one metric family of it (``family`` is None for the method)."""

    scene: str
    method: str
    family: str | None


@dataclass(frozen=True)
class SceneWork:
    """A request with the registries that it is read with: all of it can be pickled.

    Attributes:
        request: what to do; its scenes are left to whoever hands out tasks.
        methods, metrics: where names come from.
        folder: relative paths are meant from here.
        token: tells one work from another; the only thing that is compared.
    """

    request: RunRequest = field(compare=False)
    methods: Registry[Adapter] = field(compare=False)
    metrics: Registry[type[Metric]] = field(compare=False)
    folder: Path = field(default_factory=Path.cwd, compare=False)
    token: str = field(default_factory=lambda: uuid.uuid4().hex)


class SceneRunner:
    """A `SceneWork` opened in this process: methods, metrics and the run's folder.

    Args:
        work: what to do.

    Raises:
        Unknown: a method or metric that the registries do not know.
        BadInput: two methods of one name.
    """

    def __init__(self, work: SceneWork) -> None:
        request = self.request = work.request
        self.adapters = open_methods(request.methods, work.methods)
        self.store = RunStore(request.out)
        cache = ScoreCache(request.score_cache or self.store.root / "cache" / "scores")
        chosen = replace(request.metric_options, answers=self.store.root / "answers" / "llava.jsonl")
        options = request.options
        self.scorer = Scorer(request.metrics, work.metrics, options.weights_dir, options.device, cache, chosen)
        self.versions = {name: adapter.version(options) for name, adapter in self.adapters.items()}
        self._specs = self.scorer.specs
        self._listing = FileListing()

    def finish(self, scene: str, reporter: Reporter, again: bool = False) -> SceneOutcome:
        """Do whatever the scene still needs, method by method; it is loaded once, and only if there is work.

        A cell is written after its method and again after each metric family, so a kill costs one metric at most.

        Args:
            scene: its name.
            reporter: hears of the progress.
            again: a process was lost on the scene in this run; what failed is then left as it is.
        """
        case = LazyCase(self.request.dataset, scene)
        computed, failed = 0, []
        for name in self.adapters:
            worked, record = self._cell(case, name, reporter, again).finish()
            computed += worked
            if self._failed(record):
                failed.append(name)
        reporter.scene_over(scene)
        return SceneOutcome(scene, computed, tuple(failed))

    def finished(self, scene: str) -> SceneOutcome | None:
        """How the scene went if nothing is left to do, read from its files; None if something is."""
        failed = []
        for name in self.adapters:
            record, work = self._left(name, scene, self.request.retry_failed)
            if record is None or work:
                return None
            if self._failed(record):
                failed.append(name)
        return SceneOutcome(scene, 0, tuple(failed))

    def next_step(self, scene: str) -> CellLeft | None:
        """The first step that the files do not have: the one that a process which is gone was at."""
        for name in self.adapters:
            record, work = self._left(name, scene, False)
            if record is None or work.method:
                return CellLeft(scene, name, None)
            if work:
                return CellLeft(scene, name, self.scorer.families(work.metrics)[0])
        return None

    def give_up(self, step: CellLeft, error: Exception) -> None:
        """Record that a step failed for good, so that the rest of the scene can go on without it."""
        scene, name, family = step
        record = self.store.load(name, scene)
        if family is None or record is None:
            options = self.request.options
            failed = CellRecord(self.request.dataset.name, scene, name, self.versions[name], None)
            failure = Failure.of(error, "method")
            self.store.save(replace(failed, host=host_facts(options.device), failure=failure))
        else:
            scores = self.scorer.failed_family(family, error)
            self.store.save(replace(record, scores=record.scores | scores))

    def _cell(self, case: LazyCase, name: str, reporter: Reporter, again: bool) -> Cell:
        request = self.request
        return Cell(
            dataset=request.dataset.name,
            case=case,
            name=name,
            adapter=self.adapters[name],
            version=self.versions[name],
            options=request.options,
            store=self.store,
            scorer=self.scorer,
            reporter=reporter,
            retry_failed=request.retry_failed and not again,
            codec_match=request.codec_match,
            folders=(request.options.data_root, request.images),
            listing=self._listing,
            timeout=request.cell_timeout,
        )

    def _left(self, name: str, scene: str, retry_failed: bool) -> tuple[CellRecord | None, Work]:
        record = self.store.load(name, scene)
        return record, work_left(record, self.versions[name], self._specs, retry_failed)

    def _failed(self, record: CellRecord) -> bool:
        asked = replace(record, scores={key: score for key, score in record.scores.items() if key in self._specs})
        return asked.any_failed


class _Lines(SilentReporter):
    """Keeps what is said of each cell."""

    def __init__(self) -> None:
        self.said: list[str] = []

    def cell(self, line: str | None) -> None:
        if line is not None:
            self.said.append(line)


@lru_cache(maxsize=1)
def opened(work: SceneWork) -> SceneRunner:
    """The work opened in this process: once, however many of its scenes come here."""
    return SceneRunner(work)


def finish_scene(work: SceneWork, scene: str, again: bool = False) -> SceneOutcome | Exception:
    """The task of an executor whose processes are far away: finish a scene; an error comes back as a value."""
    lines = _Lines()
    try:
        if not work.folder.is_dir():
            raise BadInput(
                f"no folder {work.folder} on {platform.node()}",
                "machines that share the files of the run, the data and the code",
                "start the run in a folder that every machine has",
            )
        os.chdir(work.folder)
        return replace(opened(work).finish(scene, lines, again), lines=tuple(lines.said))
    except Exception as error:  # noqa: BLE001 - handed back whole, and raised where the run was started
        return error
