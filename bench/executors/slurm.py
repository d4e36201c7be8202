"""Scenes as jobs of SLURM, submitted through submitit in arrays; ``cluster=local`` runs them on this machine.

Every machine must see the same files: code, data, and the folder of the run. Scripts and logs of the jobs lie in
``OUT/slurm``. A job starts Python anew; for scenes of seconds, an array of ``bench run --shard I/N`` costs less.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from bench.executors.executor import Resources
from bench.executors.losses import Losses
from bench.executors.remote import finish_with, not_started, tell
from bench.host import usable_cores
from bench.progress import Reporter
from bench.scenework import SceneOutcome, SceneWork, opened
from orca.atomic import output_folder
from orca.errors import BadInput, Unavailable

__all__ = ["Slurm", "parse_options"]

_ARRAY = 1000  # jobs of one array: SLURM's default MaxArraySize is 1001
_MINUTES = 240  # submitit's own limit is 5
_LOOK_S = {"local": 0.2, "slurm": 10.0}  # how often jobs are asked after
_WHERE = "cluster"


def parse_options(given: Sequence[str] | None) -> dict[str, str | int]:
    """``["slurm_partition=gpu", "timeout_min=240"]`` as a dictionary. Raises `BadInput` for anything else."""
    options: dict[str, str | int] = {}
    for text in given or ():
        key, equals, value = text.partition("=")
        if not equals or not key.isidentifier() or not value:
            raise BadInput(f"--slurm {text}", "KEY=VALUE", "for example --slurm slurm_partition=gpu")
        options[key] = int(value) if value.isdecimal() else value
    return options


@dataclass(frozen=True)
class Slurm:
    """The SLURM of this machine.

    Attributes:
        jobs: scenes at a time; None for as many as SLURM allows.
        resources: of one scene; cores None: one.
        options: as submitit's ``AutoExecutor.update_parameters`` takes them, and ``cluster`` ("slurm" or "local").
    """

    jobs: int | None = None
    resources: Resources = field(default_factory=Resources)
    options: dict[str, str | int] = field(default_factory=dict)

    def run(self, work: SceneWork, scenes: Sequence[str], reporter: Reporter) -> Iterator[SceneOutcome]:
        """As `Executor.run`.

        Raises:
            Unavailable: submitit or SLURM is not here.
            BadInput: an option that submitit does not know.
        """
        cluster = str(self.options.get(_WHERE, "slurm"))
        executor = self._executor(work, cluster)
        losses, cells = Losses(work, reporter), len(opened(work).adapters)
        waiting = deque((scene, False) for scene in scenes)
        running: dict[Any, str] = {}
        most = min(_ARRAY, self.jobs or usable_cores()) if cluster == "local" else _ARRAY
        try:
            while waiting or running:
                room = most - len(running)
                if waiting and room >= min(len(waiting), most // 2 or 1):  # few arrays, none empty
                    batch = [waiting.popleft() for _ in range(min(room, len(waiting)))]
                    running |= self._submitted(executor, work, batch)
                for job in [job for job in running if job.done()]:
                    scene = running.pop(job)
                    outcome = _result(job)
                    if isinstance(outcome, str):
                        losses.again(scene, outcome)
                        waiting.appendleft((scene, True))
                        continue
                    yield from tell(outcome, cells, reporter)
                time.sleep(_LOOK_S.get(cluster, 1.0) if running else 0)
        finally:
            for job in running:
                job.cancel()

    def _executor(self, work: SceneWork, cluster: str) -> Any:
        try:
            import submitit
        except ImportError as error:
            raise Unavailable("submitit is not installed", "pip install 'orca-nvs[cluster]'", "install it") from error
        folder = output_folder(work.request.out / "slurm").absolute()
        parameters: dict[str, Any] = {
            "name": "bench",
            "cpus_per_task": self._cores,
            "mem_gb": self.resources.memory_gib,
            "gpus_per_node": math.ceil(self.resources.gpus),
            "timeout_min": _MINUTES,
            "slurm_array_parallelism": self.jobs or _ARRAY,
            **{key: value for key, value in self.options.items() if key != _WHERE},
        }
        try:
            executor = submitit.AutoExecutor(folder, cluster=cluster)
            executor.update_parameters(**parameters)
        except (RuntimeError, ValueError) as error:
            raise Unavailable(
                f"no cluster '{cluster}' ({error})", "slurm where sbatch is found, or local", "--slurm cluster=local"
            ) from error
        except (NameError, AssertionError) as error:
            words = " ".join(str(error).split())
            raise BadInput(f"--slurm: {words}", "what submitit takes", "see its documentation") from error
        return executor

    @property
    def _cores(self) -> int:
        return self.resources.cores or 1

    def _submitted(self, executor: Any, work: SceneWork, tasks: Sequence[tuple[str, bool]]) -> dict[Any, str]:
        """One array of jobs; each is told of one scene."""
        n, names = len(tasks), [scene for scene, _ in tasks]
        jobs = executor.map_array(finish_with, [self._cores] * n, [work] * n, names, [again for _, again in tasks])
        return dict(zip(jobs, names, strict=True))


def _result(job: Any) -> SceneOutcome | Exception | str:
    """What the task returned, or in words why its process is gone."""
    from submitit.core.utils import FailedJobError, UncompletedJobError

    try:
        result: SceneOutcome | Exception = job.result()
    except FailedJobError as error:
        return not_started(error)
    except UncompletedJobError as error:
        return " ".join(str(error).split())[:200]
    return result
