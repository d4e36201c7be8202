"""The cost of many scenes, in numbers of file operations: each grows with the scenes, none with their square."""

from __future__ import annotations

import gc
import json
import os
import random
import subprocess
import sys
import tracemalloc
from collections.abc import Callable
from functools import partial
from pathlib import Path
from statistics import fmean

import cv2
import numpy as np
import pytest

from bench.datasets import DatasetOptions
from bench.datasets.folder import open_folder
from bench.measured import read_runs
from bench.provenance import FileListing, input_files
from bench.runner import run_bench
from bench.stats import bootstrap_interval
from bench.tables import dataset_table, scene_table
from tests import scale
from tests.bench.worker_fakes import METHODS, METRICS, request_of

# Counts what opens, lists and walks, in a process of its own: an audit hook cannot be taken away again.
_COUNT = """
import json, sys
from collections import Counter
from dataclasses import replace
from pathlib import Path
from bench.measured import read_runs
from bench.runner import run_bench
from bench.tables import dataset_table, scene_table
from tests import scale
from tests.bench.worker_fakes import METHODS, METRICS

def main():
    counts, seen = {}, Counter()
    def hook(event, args):
        if event in ("open", "os.listdir", "os.scandir") and out in str(args[0]):
            seen[event] += 1
    sys.addaudithook(hook)
    scale.RUN = 8
    for n in map(int, sys.argv[2:]):
        out = str(Path(sys.argv[1]) / str(n))
        request = scale.request_at(Path(out), n)
        few = replace(request, scenes=request.scenes[: n // 20], out=Path(out) / "few")
        steps = {
            "first run": lambda: run_bench(few, None, METHODS, METRICS),
            "fill": lambda: scale.fill(request),
            "resume": lambda: run_bench(request, None, METHODS, METRICS),
            "tables": lambda: scene_table(read_runs([request.out], slim=True)),
        }
        for name, step in steps.items():
            seen.clear()
            step()
            counts.setdefault(name, []).append(sum(seen.values()))
    print(json.dumps(counts))

out = "nowhere"
main()
"""


def test_file_operations_grow_with_the_scenes(tmp_path: Path) -> None:
    script = _COUNT.replace("def main():", "def main():\n    global out")
    environment = {**os.environ, "PYTHONPATH": os.getcwd()}
    done = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path), "100", "200", "300"],
        capture_output=True,
        text=True,
        check=True,
        env=environment,
    )
    counts = json.loads(done.stdout)
    for name, (few, more, most) in counts.items():
        assert most - more == more - few, name  # exactly as many for every further hundred
    assert counts["resume"][1] - counts["resume"][0] == 100  # a scene: its record, read once
    assert counts["tables"][1] - counts["tables"][0] == 100
    assert counts["resume"][0] < 100 + 40


def _peak_kb(step: Callable[[], object]) -> float:
    gc.collect()
    tracemalloc.start()
    try:
        step()
        return tracemalloc.get_traced_memory()[1] / 1e3
    finally:
        tracemalloc.stop()


@pytest.mark.slow
@pytest.mark.parametrize("step", ["start", "resume", "tables"])
def test_memory_of_a_scene_does_not_grow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str) -> None:
    """What Python holds at most, with 50, 100 and 400 scenes: the last 300 take no more each than those before.

    A tenth more is allowed, and 5 kB in all. (Measured: 0.2 kB a scene, 3.2 and 52, the same to a tenth of a percent.)
    """
    monkeypatch.setattr(scale, "RUN", 8)
    peaks = []
    for scenes in (10, 50, 100, 400):  # the first warms up
        folder = tmp_path / str(scenes)
        if step != "start":
            scale.fill(scale.request_at(folder, scenes))
        peaks.append(_peak_kb(partial(scale.step, step, folder, scenes)))
    _, few, more, most = peaks
    assert (most - more) / 300 <= 1.1 * max(0.0, more - few) / 50 + 5 / 300
    assert most / 400 < 100  # kB; a result file is 8 kB


def test_a_folder_of_inputs_is_looked_through_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scenes = [f"s{i}" for i in range(30)]
    for scene in scenes:
        (tmp_path / "data").mkdir(exist_ok=True)
        (tmp_path / "data" / f"{scene}.png").write_text(scene)
        (tmp_path / "data" / f"{scene}_depth.v2.png").write_text(scene)
    walks: list[object] = []
    walk = os.walk
    monkeypatch.setattr(os, "walk", lambda folder: [walks.append(folder), walk(folder)][1])
    listing = FileListing()
    found = [input_files(tmp_path, None, ("data",), scene, listing) for scene in scenes]
    assert len(walks) == 1
    assert found == [input_files(tmp_path, None, ("data",), scene) for scene in scenes]
    assert found[1].keys() == {"data/s1.png", "data/s1_depth.v2.png"}  # and nothing of s10
    (tmp_path / "data" / "s3.png").unlink()
    assert input_files(tmp_path, None, ("data",), "s3", listing).keys() == {"data/s3_depth.v2.png"}


def test_a_folder_of_images_is_listed_once_until_it_changes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for i in range(12):
        cv2.imwrite(str(tmp_path / f"i{i:02d}.png"), np.full((24, 32, 3), i, np.uint8))
    lists: list[object] = []
    iterdir = Path.iterdir
    monkeypatch.setattr(Path, "iterdir", lambda folder: [lists.append(folder), iterdir(folder)][1])
    dataset = open_folder(DatasetOptions(images=tmp_path))
    assert [dataset.load(scene).name for scene in dataset.scenes()[:3]] == ["i00", "i01", "i02"]
    assert len(lists) == 1
    (tmp_path / "i03.png").unlink()
    os.utime(tmp_path, ns=(1, 1))  # clocks may be too coarse for this test
    assert "i03" not in dataset.scenes()


def test_slim_results_make_the_same_tables(tmp_path: Path) -> None:
    request = request_of(tmp_path, count=2)
    run_bench(request, None, METHODS, METRICS)
    whole, slim = read_runs([request.out]), read_runs([request.out], slim=True)
    assert dataset_table(whole) == dataset_table(slim)
    assert scene_table(whole) == scene_table(slim)
    one, other = (slim.records[method, "s00000"] for method in ("copy", "brighter"))
    assert one.host is other.host
    assert one.frames is other.frames
    assert one.scores["grey"].per_frame is None


def test_resamples_are_those_of_pythons_generator() -> None:
    values = [random.Random(3).gauss(0, 1) for _ in range(57)]
    draw = random.Random(5)
    means = sorted(fmean(draw.choices(values, k=57)) for _ in range(400))
    low, high = bootstrap_interval(values, resamples=400, seed=5)
    at = [0.025 * 399, 0.975 * 399]
    want = [means[int(x)] + (means[int(x) + 1] - means[int(x)]) * (x - int(x)) for x in at]
    assert [low, high] == pytest.approx(want, abs=1e-14)
