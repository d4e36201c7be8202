"""Scenes, methods and a metric for tests with several processes: every call leaves a line in a file they all see."""

from __future__ import annotations

import hashlib
import os
import signal
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.adapters import Adapter, MethodOutput, RunOptions
from bench.datasets import SceneCase
from bench.metrics import Metric, MetricInput, MetricSpec, Score
from bench.request import RunRequest
from bench.trajectories import Trajectory
from orca.camera import Camera
from orca.errors import CannotWrite
from orca.registry import Registry

FRAMES = 3


@dataclass(frozen=True)
class Scenes:
    """As many scenes as asked for, each of another grey; the K of the k-th has a focal length of its own."""

    count: int = 6
    frames: int = FRAMES
    name: str = "workers"

    def scenes(self) -> Sequence[str]:
        return [f"s{i:05d}" for i in range(self.count)]

    def load(self, scene: str) -> SceneCase:
        camera = Camera.from_fov(8, 6, 60.0)
        poses = np.tile(np.eye(4), (self.frames, 1, 1))
        poses[-1, 0, 3] = 0.01 * int(scene[1:])
        return SceneCase(
            dataset=self.name,
            name=scene,
            image=np.full((6, 8, 3), int(scene[1:]) % 200, np.uint8),
            camera=camera,
            depth=np.ones((6, 8), np.float32),
            depth_source="fake",
            depth_is_metric=True,
            fov_source="fake",
            trajectory=Trajectory("still", camera.K, poses, 8, 6),
            eval_indices=tuple(range(self.frames)),
        )


def told(folder: Path | None, line: str) -> None:
    """Add a line to the log, in one write."""
    if folder is not None and (folder / "calls").is_file():
        with (folder / "calls").open("a") as file:
            file.write(f"{line}\n")


def calls(folder: Path) -> Counter[str]:
    """The calls so far, over all processes."""
    return Counter((folder / "calls").read_text().split("\n")[:-1])


def obey(folder: Path | None, step: str) -> None:
    """Do what a file of the name ``step`` in the folder asks for: "kill", "kill once", "full disk", "sleep", "spin"."""
    order = None if folder is None else folder / step
    if order is None or not order.is_file():
        return
    what = order.read_text()
    if what == "kill once":
        order.unlink()
    if what.startswith("kill"):
        os.kill(os.getpid(), signal.SIGKILL)
    if what == "sleep":
        time.sleep(600)
    if what == "spin":  # compiled code that hears no signal
        hashlib.pbkdf2_hmac("sha256", b"", b"", 2**31 - 1)
    if what == "full disk":
        raise CannotWrite("no room", "a disk with room", "make room")


@dataclass(frozen=True)
class Method:
    """Copies the input; slow enough to be seen only when told so."""

    name: str
    plus: int

    def version(self, options: RunOptions) -> str:
        return "1"

    def run(self, case: SceneCase, options: RunOptions) -> MethodOutput:
        told(options.data_root, f"{self.name} {case.name}")
        options.progress("fit", 0, 1)
        obey(options.data_root, f"{self.name} {case.name}")
        frames = np.repeat(case.image[None] + np.uint8(self.plus), len(case.eval_indices), axis=0)
        return MethodOutput(frames=frames, timing={"fit": 0.5}, model={"anchors": 7})


class Grey:
    """Mean grey value."""

    def specs(self, weights_dir: Path | None) -> tuple[MetricSpec, ...]:
        return (MetricSpec("grey", "Grey", True, (0, 255), "mean", "1", 2),)

    def compute(self, given: MetricInput) -> dict[str, Score]:
        told(given.weights_dir, f"grey {given.case.name}")
        obey(given.weights_dir, f"grey {given.case.name}")
        means = tuple(float(frame.mean()) for frame in given.output.frames)
        return {"grey": Score(float(np.mean(means)), len(means), per_frame=means)}


class Size:
    """Number of pixels."""

    def specs(self, weights_dir: Path | None) -> tuple[MetricSpec, ...]:
        return (MetricSpec("size", "Size", True, (0, None), "pixels", "1", 0),)

    def compute(self, given: MetricInput) -> dict[str, Score]:
        return {"size": Score(float(given.output.frames[0].size), 1)}


COPY, BRIGHTER = Method("copy", 0), Method("brighter", 20)

_HERE = "tests.bench.worker_fakes"
METHODS: Registry[Adapter] = Registry("method", {"copy": f"{_HERE}:COPY", "brighter": f"{_HERE}:BRIGHTER"})
METRICS: Registry[type[Metric]] = Registry("metric", {"grey": f"{_HERE}:Grey", "size": f"{_HERE}:Size"})


def request_of(folder: Path, out: str = "run", count: int = 6, scenes: Sequence[str] | None = None) -> RunRequest:
    """A request over these fakes; ``folder`` gets the run and the log of calls."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "calls").touch()
    dataset = Scenes(count)
    return RunRequest(
        dataset,
        tuple(dataset.scenes() if scenes is None else scenes),
        ("copy", "brighter"),
        ("grey", "size"),
        folder / out,
        RunOptions(data_root=folder, weights_dir=folder),
    )
