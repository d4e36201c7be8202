"""One method on one case, done in the worker: what to do, and how it came out."""

from __future__ import annotations

import contextlib
import io
import json
import tempfile
import time
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

from bench.adapters import METHODS, MethodOutput, RunOptions
from bench.datasets.case import SceneCase
from bench.stability.case import StabilityCase
from bench.stability.catalogue import find_case
from bench.stability.outcome import CRASH, DEGRADED, EXACT, HOLES_ALLOWED, SILENT_WRONG, TYPED, Verdict, failed, judge

__all__ = ["CaseJob", "Done", "Job"]

_COMMAND_PATH = ("--trajectory", "swing")
_COMMAND_FRAMES = ("--frames", "5")


@dataclass(frozen=True)
class Done:
    """What came of a job: the verdict, and the seconds that the method took."""

    verdict: Verdict
    seconds: float


class Job(Protocol):
    """Work for a worker; travels to another process, so it is small and can be pickled."""

    @property
    def name(self) -> str:
        """What messages call it."""
        ...

    @property
    def leaves_traces(self) -> bool:
        """Whether the process is not to be trusted with another job afterwards."""
        ...

    def run(self) -> Done:
        """Do it; every exception becomes a verdict."""
        ...


@dataclass(frozen=True)
class CaseJob:
    """A method on a stability case.

    Attributes:
        case: name of the case.
        method: name of the method.
        preset: preset of ORCA.
        seed: the random seed.
    """

    case: str
    method: str
    preset: str = "draft"
    seed: int = 0

    @property
    def name(self) -> str:
        """See `Job`."""
        return f"{self.case}/{self.method}"

    @property
    def leaves_traces(self) -> bool:
        """Libraries remember that a thread or a file could not be made."""
        return find_case(self.case).around is not nullcontext

    def run(self) -> Done:
        """See `Job`."""
        case, phase = find_case(self.case), "load"
        started = time.perf_counter()
        with tempfile.TemporaryDirectory(prefix="stability-") as made, tempfile.TemporaryDirectory() as work:
            try:
                if case.command is not None:
                    verdict = _command(case, case.command(Path(made)), Path(work), self.preset)
                    return Done(_without(verdict, made, work), time.perf_counter() - started)
                scene = _load(case, Path(made))
                started, phase = time.perf_counter(), "method"
                options = RunOptions(preset=self.preset, seed=self.seed, work_dir=Path(work))
                with case.around():
                    output = self._output(case, scene, options)
                seconds = time.perf_counter() - started
                complaint = _broken_scene(Path(work)) or (None if case.check is None else case.check(scene, output))
                return Done(judge(scene, output, complaint), seconds)
            except (Exception, SystemExit) as error:  # noqa: BLE001 - whatever happens is what is being measured
                return Done(_without(failed(error, phase), made, work), time.perf_counter() - started)

    def _output(self, case: StabilityCase, scene: SceneCase, options: RunOptions) -> MethodOutput:
        if case.priors is None:
            return METHODS.get(self.method).run(scene, options)
        from bench.stability.faulty import run_with_priors

        return run_with_priors(scene, options, case.priors)


def _without(verdict: Verdict, *folders: str) -> Verdict:
    """The verdict in words that are the same in the next run: without the names of temporary folders."""
    detail = verdict.detail
    for folder in folders:
        detail = detail.replace(f"{folder}/", "").replace(folder, "the folder")
    return replace(verdict, detail=detail)


def _load(case: StabilityCase, folder: Path) -> SceneCase:
    if case.scene is None:
        raise TypeError(f"case {case.name} has neither a scene nor a command")
    scene = case.scene(folder)
    return replace(scene, name=case.name)


def _broken_scene(folder: Path) -> str | None:
    """A scene file with values that are no numbers; None where there is no file, or nothing is wrong."""
    path = folder / "scene.safetensors"
    if not path.is_file():
        return None
    from safetensors.torch import load_file

    broken = [name for name, tensor in load_file(path).items() if not bool(tensor.isfinite().all())]
    return f"a scene with NaN or infinities in {', '.join(broken)}" if broken else None


def _command(case: StabilityCase, arguments: list[str], folder: Path, preset: str) -> Verdict:
    """Run ``orca reconstruct`` in this process and judge what it says and leaves behind."""
    from orca.cli import main

    words = ["reconstruct", *arguments, "--json", "--preset", preset, "--local-files-only", *_COMMAND_FRAMES]
    words += () if "--trajectory" in arguments else _COMMAND_PATH
    words += () if "--out" in arguments else ("--out", str(folder))
    said, complained = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(complained), case.around():
        code = main(words)
    if code != 0:
        return Verdict(TYPED if code == 2 else CRASH, _complaint(complained.getvalue()) or f"exit code {code}")
    broken = _broken_scene(folder)
    if broken:
        return Verdict(SILENT_WRONG, broken)
    return _said(json.loads(said.getvalue()))


def _complaint(text: str) -> str:
    """What a command says went wrong, on one line, without its progress bars."""
    _, begin, said = text.rpartition("orca: ")
    return " ".join((begin + said).split())[:400]


def _said(document: dict[str, object]) -> Verdict:
    """The verdict on a scene that the command line made: its own words about holes and depth count as admitted."""
    psnr = document["input_psnr"]
    numbers = {"input_psnr": float(psnr["final"])} if isinstance(psnr, dict) else {}
    provenance = document["provenance"]
    notes = [str(note) for note in provenance.get("depth_notes", [])] if isinstance(provenance, dict) else []
    holes = document.get("holes")
    if isinstance(holes, float):
        numbers["holes"] = holes
        if holes > HOLES_ALLOWED:
            notes.append(f"{holes:.1%} holes")
    return Verdict(DEGRADED if notes else EXACT, "; ".join(notes), numbers)
