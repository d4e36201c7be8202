"""One method on one scene, from what is stored to what is asked for."""

from __future__ import annotations

import logging
import time
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from bench.adapters import Adapter, MethodOutput, RunOptions
from bench.checks import check_output
from bench.codec import ALREADY_CODED, CODEC, coded_output, holding
from bench.datasets.case import Dataset, SceneCase
from bench.frames import frame_hashes, load_frames, save_frames, stored_precision
from bench.host import host_facts
from bench.memory import peak_memory
from bench.plan import Work, work_left
from bench.progress import Reporter
from bench.provenance import FileListing, case_hashes, input_files, output_hashes
from bench.record import FAILED, CellRecord, Failure, ScoreRecord
from bench.scoring import Scorer
from bench.store import RunStore
from bench.timelimit import time_limit
from orca.errors import BadInput, CannotWrite, TimedOut

__all__ = ["Cell", "LazyCase"]

_log = logging.getLogger(__name__)


class LazyCase:
    """A scene that is loaded when it is first needed, once."""

    def __init__(self, dataset: Dataset, scene: str) -> None:
        self.scene = scene
        self.seconds = 0.0
        self._dataset = dataset
        self._loaded: SceneCase | Exception | None = None

    def get(self) -> SceneCase:
        """The scene. Raises, each time, what loading it raised."""
        if self._loaded is None:
            started = time.perf_counter()
            try:
                self._loaded = self._dataset.load(self.scene)
            except Exception as error:  # noqa: BLE001 - raised below, for every method of the scene
                self._loaded = error
            self.seconds = time.perf_counter() - started
        if isinstance(self._loaded, Exception):
            raise self._loaded
        return self._loaded


@dataclass
class Cell:
    """One method on one scene.

    Attributes:
        dataset: name of the data set.
        case: the scene.
        name: name of the method.
        adapter: the method.
        version: its version with these options.
        options: preset, seed, device and folders.
        store: where results lie.
        scorer: the metrics asked for.
        reporter: hears of the progress.
        retry_failed: run what failed again.
        codec_match: send every picture through `bench.codec` before anything is scored.
        folders: data root and folder of images, for the hashes of the input files.
        listing: of those folders, shared by the cells of a run.
        timeout: seconds that loading, the method, and each metric family may take; None for no limit.
    """

    dataset: str
    case: LazyCase
    name: str
    adapter: Adapter
    version: str
    options: RunOptions
    store: RunStore
    scorer: Scorer
    reporter: Reporter
    retry_failed: bool = False
    codec_match: bool = False
    folders: tuple[Path | None, Path | None] = (None, None)
    listing: FileListing = field(default_factory=FileListing)
    timeout: float | None = None
    _phase: str = field(default="load", init=False)

    @property
    def scene(self) -> str:
        """Name of the scene."""
        return self.case.scene

    def finish(self) -> tuple[bool, CellRecord]:
        """Do what is left; return whether that was anything, and the record."""
        record = self.store.load(self.name, self.scene)
        work = work_left(record, self.version, self.scorer.specs, self.retry_failed)
        if record is not None and not work:
            self.reporter.cell(None)
            return False, record
        _log.debug("%s %s: %s", self.scene, self.name, work.why)
        started = time.perf_counter()
        if record is None or work.method:
            record = self._run_and_score(work.metrics)
        else:
            record = self._score_stored(record, work)
        self.reporter.cell(f"{self.scene} {self.name}: {_outcome(record)}, {time.perf_counter() - started:.1f} s")
        return True, record

    def _run_and_score(self, metrics: tuple[str, ...]) -> CellRecord:
        record, output = self._run_method()
        self.store.save(record)
        return record if output is None else self._score(record, self.case.get(), output, metrics)

    def _run_method(self) -> tuple[CellRecord, MethodOutput | None]:
        """The record of a run of the method, without scores, and its frames unless it failed."""
        self._tell("load", 0, 1)
        record = CellRecord(self.dataset, self.scene, self.name, self.version, None)
        record = replace(record, host=host_facts(self.options.device))
        try:
            with self._limited("loading the scene", record):
                case = self.case.get()
            record = replace(record, trajectory_sha256=case.trajectory.sha256, inputs=self._inputs(case))
            self._tell("method", 0, 1)
            with peak_memory() as memory:
                started = time.perf_counter()
                with self._limited(f"method {self.name}", record):
                    output = self.adapter.run(case, self._options())
                wall = time.perf_counter() - started
            self._tell("check", 0, 1)
            check_output(case, output)
            codec, output = self._coded(case, output)
        except CannotWrite:
            raise
        except Exception as error:  # noqa: BLE001 - a failure is a result: typed, stored, and a cell of the table
            _log.debug("%s %s failed", self.scene, self.name, exc_info=error)
            return replace(record, failure=Failure.of(error, self._phase)), None
        finally:
            self.store.drop_empty_work_dir(self.name, self.scene)
        output, record = stored_precision(output), replace(record, codec=codec)
        save_frames(self.store.frames_path(self.name, self.scene), output)
        self.store.save_trajectory(case.trajectory)
        record = self._described(record, case, output, {"wall_s": wall, "memory": memory.to_json()})
        return record, replace(output, model=dict(record.model))  # as it is when it is read back from the disk

    def _described(
        self, record: CellRecord, case: SceneCase, output: MethodOutput, measured: dict[str, Any]
    ) -> CellRecord:
        phases = {key: value for key, value in output.timing.items() if key != "render_ms_per_frame"}
        timing = {
            "phases": phases,
            **measured,
            "load_s": self.case.seconds,
            "render_ms_per_frame": output.timing.get("render_ms_per_frame"),
            "metrics": {},
        }
        frames = frame_hashes(output.frames, case.eval_indices)
        return replace(
            record,
            frames=frames,
            views=output_hashes(output),
            timing=timing,
            model={"depth_source": case.depth_source, "fov_source": case.fov_source, **output.model},
            notes=tuple(output.notes),
            host=host_facts(self.options.device),  # again: threads are known once torch is loaded
        )

    def _score_stored(self, record: CellRecord, work: Work) -> CellRecord:
        """Add missing scores to a finished cell from its stored frames; run the method again only if they are gone."""
        self._tell("load", 0, 1)
        try:
            case = self.case.get()
        except Exception as error:  # noqa: BLE001 - the finished scores stay; the missing ones say why
            return self._keep(record, work.metrics, error)
        self._check_case(record, case)
        output = load_frames(self.store.frames_path(self.name, self.scene), record)
        if output is not None:
            return self._score(record, case, output, work.metrics)
        fresh, output = self._run_method()
        if output is None:
            gone = BadInput("the frames of this cell are gone and the method failed", "frames", "see --debug")
            return self._keep(record, work.metrics, gone)
        self.store.save(fresh)
        return self._score(fresh, case, output, self.scorer.ids)

    def _score(self, record: CellRecord, case: SceneCase, output: MethodOutput, metrics: tuple[str, ...]) -> CellRecord:
        """Compute the metrics, writing the record after each family."""
        families = self.scorer.families(metrics)
        for done, family in enumerate(families):
            self._tell(f"metric {family}", done, len(families))
            scores, seconds = self._computed(family, record, case, output)
            spent = {**record.timing.get("metrics", {}), family: seconds}
            record = replace(record, scores=record.scores | scores, timing={**record.timing, "metrics": spent})
            self.store.save(record)
        return record

    def _computed(
        self, family: str, record: CellRecord, case: SceneCase, output: MethodOutput
    ) -> tuple[dict[str, ScoreRecord], float]:
        """The scores of one family and their seconds; scores that say so where it took too long."""

        def stuck(error: TimedOut) -> None:
            self.store.save(replace(record, scores=record.scores | self.scorer.failed_family(family, error)))

        try:
            with time_limit(self.timeout, f"metric {family}", stuck):
                return self.scorer.compute(family, case, output)
        except TimedOut as error:
            return self.scorer.failed_family(family, error), self.timeout or 0.0

    def _limited(self, what: str, record: CellRecord) -> AbstractContextManager[None]:
        """The time limit on what comes before the scores; a step that does not come back is a failure of the cell."""
        phase = self._phase
        return time_limit(
            self.timeout, what, lambda error: self.store.save(replace(record, failure=Failure.of(error, phase)))
        )

    def _keep(self, record: CellRecord, metrics: tuple[str, ...], error: Exception) -> CellRecord:
        record = replace(record, scores=record.scores | self.scorer.failed_scores(metrics, error))
        self.store.save(record)
        return record

    def _coded(self, case: SceneCase, output: MethodOutput) -> tuple[str | None, MethodOutput]:
        """What the pictures went through, and the pictures after it."""
        if output.coded:
            return ALREADY_CODED, output
        if not self.codec_match:
            return None, output
        self._tell("codec", 0, 1)
        return CODEC, coded_output(output, holding(case.eval_indices))

    def _inputs(self, case: SceneCase) -> dict[str, Any]:
        folders = (self.dataset, self.name.partition("-")[0])
        return {**case_hashes(case), "files": input_files(*self.folders, folders, self.scene, self.listing)}

    def _check_case(self, record: CellRecord, case: SceneCase) -> None:
        """New scores must be of the scene that the stored frames are of."""
        self._check_cameras(record, case)
        now = case_hashes(case)
        changed = [part for part, known in record.inputs.items() if part in now and now[part] != known]
        if changed:
            raise BadInput(
                f"the {' and '.join(changed)} of scene {self.scene} changed since {self.name} ran in {self.store.root}",
                f"the scene that {self.name} was given then",
                "put the old files back, give another --out, or delete the old run",
            )

    def _check_cameras(self, record: CellRecord, case: SceneCase) -> None:
        indices = tuple(frame.index for frame in record.frames)
        if (record.trajectory_sha256, indices) != (case.trajectory.sha256, case.eval_indices):
            raise BadInput(
                f"scene {self.scene} has other cameras now than when {self.name} ran in {self.store.root}",
                f"the trajectory with SHA-256 {record.trajectory_sha256}",
                "give another --out, or delete the old run",
            )

    def _options(self) -> RunOptions:
        return replace(
            self.options,
            work_dir=self.store.fresh_work_dir(self.name, self.scene),
            progress=self._tell,
        )

    def _tell(self, phase: str, done: int, total: int) -> None:
        self._phase = phase
        self.reporter.phase(self.scene, self.name, phase, done, total)


def _outcome(record: CellRecord) -> str:
    if record.failure is not None:
        return f"FAILED ({record.failure.summary})"
    broken = [key for key, score in record.scores.items() if score.status == FAILED]
    return f"scored, but failed: {', '.join(broken)}" if broken else "done"
