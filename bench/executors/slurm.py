"""Scenes as jobs of SLURM, submitted through submitit in arrays; ``cluster=local`` runs them on this machine.

Every machine must see the same files: code, data, and the folder of the run. Scripts and logs of the jobs lie in
``OUT/slurm``. A job starts Python anew; for scenes of seconds, an array of ``bench run --shard I/N`` costs less.
"""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from bench.executors.executor import Resources
from bench.executors.losses import Losses
from bench.executors.remote import tell
from bench.progress import Reporter
from bench.scenework import SceneOutcome, SceneWork, finish_scene, opened
from orca.atomic import output_folder
from orca.errors import BadInput, OrcaError, Unavailable

__all__ = ["Slurm", "parse_options"]

_ARRAY = 1000  # jobs of one array: SLURM's default MaxArraySize is 1001
_LOOK_S = {"local": 0.2, "slurm": 10.0}  # how often jobs are asked after
_HERE = "cluster"


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
        cluster = str(self.options.get(_HERE, "slurm"))
        executor = self._executor(work, cluster)
        losses, cells = Losses(work, reporter), len(opened(work).adapters)
        waiting = deque((scene, False) for scene in scenes)
        running: dict[Any, str] = {}
        try:
            while waiting or running:
                room = min(_ARRAY, self.jobs or _ARRAY) - len(running)
                if waiting and room > 0:
                    running |= _submitted(executor, work, [waiting.popleft() for _ in range(min(room, len(waiting)))])
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
        given: dict[str, Any] = {key: value for key, value in self.options.items() if key != _HERE}
        if cluster == "slurm" and self.jobs is not None:
            given.setdefault("slurm_array_parallelism", self.jobs)
        cores = self.resources.cores or 1
        try:
            executor = submitit.AutoExecutor(folder, cluster=cluster)
            executor.update_parameters(
                name="bench",
                cpus_per_task=cores,
                mem_gb=self.resources.memory_gib,
                gpus_per_node=int(-(-self.resources.gpus // 1)),
                **given,
            )
        except (RuntimeError, ValueError) as error:
            raise Unavailable(
                f"no cluster '{cluster}' ({error})", "slurm where sbatch is found, or local", "--slurm cluster=local"
            ) from error
        except (NameError, TypeError) as error:
            raise BadInput(
                f"--slurm: {error}", "what submitit's AutoExecutor takes", "see its documentation"
            ) from error
        return executor


def _submitted(executor: Any, work: SceneWork, tasks: Sequence[tuple[str, bool]]) -> dict[Any, str]:
    """One array of jobs; each is told of one scene."""
    names, again = [scene for scene, _ in tasks], [flag for _, flag in tasks]
    cores = int(executor.parameters.get("cpus_per_task", 1)) if hasattr(executor, "parameters") else 1
    jobs = executor.map_array(_finish, [work] * len(tasks), names, again, [cores] * len(tasks))
    return dict(zip(jobs, names, strict=True))


def _finish(work: SceneWork, scene: str, again: bool, cores: int) -> SceneOutcome | Exception:
    """In a job: with the threads that it was given, told before anything that makes threads is imported."""
    for name in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, str(cores))
    return finish_scene(work, scene, again)


def _result(job: Any) -> SceneOutcome | Exception | str:
    """What the task returned, or in words why it returned nothing."""
    from submitit.core.utils import FailedJobError, UncompletedJobError

    try:
        result: SceneOutcome | Exception = job.result()
    except (FailedJobError, UncompletedJobError) as error:
        return " ".join(str(error).split())[:200]
    except OrcaError as error:
        return error
    return result
