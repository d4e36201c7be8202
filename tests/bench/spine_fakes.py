"""A data set, methods and metrics small enough to count every call; reached through registries, as the real ones."""

from __future__ import annotations

import hashlib
import json
import os
import resource
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bench.adapters import Adapter, MethodOutput, RunOptions
from bench.datasets import SceneCase
from bench.metrics import Metric, MetricInput, MetricSpec, Score
from bench.trajectories import Trajectory
from orca.camera import Camera
from orca.errors import BadInput, Unavailable
from orca.registry import Registry

CALLS: Counter[str] = Counter()
SWITCHES: dict[str, str] = {}  # what a test makes a fake do: "version", "orca-like": "crash", ...
VARIABLE = "BENCH_FAKES"  # the same for processes that are started, as JSON
SWITCHES.update(json.loads(os.environ.get(VARIABLE, "{}")))


def reset() -> None:
    CALLS.clear()
    SWITCHES.clear()


@dataclass
class FakeDataset:
    """Scenes a, b, c of 6x8 pixels, three evaluated frames of five."""

    name: str = "fake"
    names: tuple[str, ...] = ("a", "b", "c")
    shift: float = 0.0
    broken: frozenset[str] = field(default_factory=frozenset)

    def scenes(self) -> Sequence[str]:
        return self.names

    def load(self, scene: str) -> SceneCase:
        CALLS[f"load {scene}"] += 1
        if scene in self.broken:
            raise BadInput(f"scene {scene} is not an image", "an image", "mend it")
        camera = Camera.from_fov(8, 6, 60.0)
        poses = np.tile(np.eye(4), (5, 1, 1))
        poses[3, 0, 3] = self.shift
        return SceneCase(
            dataset=self.name,
            name=scene,
            image=np.full((6, 8, 3), 10 * (ord(scene[0]) % 20), np.uint8),
            camera=camera,
            depth=np.ones((6, 8), np.float32),
            depth_source="fake",
            depth_is_metric=True,
            fov_source="fake",
            trajectory=Trajectory("still", camera.K, poses, 8, 6),
            eval_indices=(0, 2, 4),
        )


@dataclass(frozen=True)
class FakeMethod:
    name: str
    grey: int

    def version(self, options: RunOptions) -> str:
        return SWITCHES.get("version", "1")

    def run(self, case: SceneCase, options: RunOptions) -> MethodOutput:
        CALLS[f"run {self.name} {case.name}"] += 1
        options.progress("fit", 1, 1)
        what = SWITCHES.get(f"{self.name} {case.name}", "")
        if what == "crash":
            raise IndexError("percentile of an empty array")
        if what == "interrupt":
            raise KeyboardInterrupt
        _misbehave(what)
        if what == "bad input":
            raise BadInput("a sky and nothing else", "a scene", "choose another")
        if what == "leave a file" and options.work_dir is not None:
            (options.work_dir / "scene.safetensors").touch()
        frames = np.full((2 if what == "short" else 3, 6, 8, 3), self.grey, np.uint8)
        frames += np.arange(len(frames), dtype=np.uint8)[:, None, None, None]
        coverage = np.full(frames.shape[:3], np.nan if what == "nan" else 0.3, np.float32)
        return MethodOutput(
            frames=frames,
            coverage=coverage,
            input_view=case.image,
            timing={"fit": 1.5, "render": 0.5, "render_ms_per_frame": 20.0},
            model={"anchors": 100},
        )


def _misbehave(how: str) -> None:
    """Sleep for ever, compute for ever where no signal is heard, or want more memory than there is."""
    if how == "hang":
        time.sleep(600)
    if how == "spin":
        hashlib.pbkdf2_hmac("sha256", b"", b"", 2**31 - 1)
    if how == "memory":
        np.empty(2**60, np.uint8)
    if how == "eat":
        _eat()


def _eat() -> None:
    """Take memory, and write to it, until the system refuses: from now on this process may have 256 MiB more."""
    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size + 2**28, resource.getrlimit(resource.RLIMIT_AS)[1]))
    held = []
    while len(held) < 32:  # a limit that does not hold must not take the machine's memory
        held.append(np.ones(2**22))
        CALLS["eaten 32 MiB"] += 1
    raise AssertionError("nothing was refused")


class Bright:
    """Two ids from one class: mean and largest grey value; and how much is covered."""

    def specs(self, weights_dir: Path | None) -> tuple[MetricSpec, ...]:
        version = SWITCHES.get("bright version", "1")
        return (
            MetricSpec("bright", "Brightness", True, (0, 255), "mean", version, 2),
            MetricSpec("brightest", "Largest", True, (0, 255), "max", version, 0),
        )

    def compute(self, given: MetricInput) -> dict[str, Score]:
        CALLS["bright"] += 1
        if SWITCHES.get("bright") == "crash":
            raise ZeroDivisionError("no pixels")
        if SWITCHES.get("bright") == "nan":
            return {"bright": Score(float("nan"), 1), "brightest": Score(None, 1)}
        if SWITCHES.get("bright") == "interrupt":
            raise KeyboardInterrupt
        _misbehave(SWITCHES.get(f"bright {given.case.name}", ""))
        frames = given.output.frames.astype(float)
        means = tuple(frames.mean(axis=(1, 2, 3)))
        return {
            "bright": Score(float(np.mean(means)), len(frames), per_frame=means, detail={"worst": np.float32("inf")}),
            "brightest": Score(frames.max(), len(frames)),
        }


class Covered:
    """Depends on the coverage, so it shows whether stored coverage is the scored one."""

    def specs(self, weights_dir: Path | None) -> tuple[MetricSpec, ...]:
        return (MetricSpec("covered", "Covered", False, (0, 1), "mean", "1", 4),)

    def compute(self, given: MetricInput) -> dict[str, Score]:
        CALLS["covered"] += 1
        assert given.output.coverage is not None
        return {"covered": Score(float(given.output.coverage.mean()), 3)}


class OnlyA:
    """Says by itself that it applies to scene a only."""

    def specs(self, weights_dir: Path | None) -> tuple[MetricSpec, ...]:
        return (MetricSpec("only_a", "Only A", True, (None, None), "only a", "1", 1),)

    def compute(self, given: MetricInput) -> dict[str, Score]:
        if given.case.name == "a":
            return {"only_a": Score(1.0, 1)}
        return {"only_a": Score(None, 0, "no true view in this scene")}


class NoWeights:
    def specs(self, weights_dir: Path | None) -> tuple[MetricSpec, ...]:
        return (MetricSpec("learned", "Learned", True, (None, None), "v", "1", 1),)

    def compute(self, given: MetricInput) -> dict[str, Score]:
        CALLS["learned"] += 1
        if SWITCHES.get("weights") == "here":
            return {"learned": Score(5.0, 3)}
        raise Unavailable("learned needs w.pth", "w.pth in --weights-dir", "get it")


DARK = FakeMethod("dark", 10)
LIGHT = FakeMethod("light", 200)
ALSO_DARK = FakeMethod("also-dark", 10)

_HERE = "tests.bench.spine_fakes"
METHODS: Registry[Adapter] = Registry(
    "method", {"dark": f"{_HERE}:DARK", "light": f"{_HERE}:LIGHT", "also-dark": f"{_HERE}:ALSO_DARK"}
)
METRICS: Registry[type[Metric]] = Registry(
    "metric",
    {
        "bright": f"{_HERE}:Bright",
        "brightest": f"{_HERE}:Bright",
        "covered": f"{_HERE}:Covered",
        "only_a": f"{_HERE}:OnlyA",
        "learned": f"{_HERE}:NoWeights",
    },
)
