"""DIV2K: all 100 or nothing, the subset under a name of its own, and the two ways to count a failure."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from bench.cli import main
from bench.datasets import DATASETS, open_dataset
from bench.datasets.div2k import SCENES
from bench.exclusion import failed_anywhere, without_failed_anywhere
from bench.measured import Measured, read_runs
from bench.runner import RunRequest, run_bench
from bench.tables import dataset_table
from orca.errors import Unavailable, Unknown
from orca.images import save_image
from tests.bench import spine_fakes as fakes

PICTURE = np.full((16, 20, 3), 90, np.uint8)


def test_layouts_and_names(tmp_path: Path) -> None:
    assert (SCENES[0], SCENES[-1], len(SCENES)) == ("0801", "0900", 100)
    with pytest.raises(Unavailable, match="0 of the 100"):
        open_dataset("div2k-subset", data_root=tmp_path).scenes()
    for folder, scene in (("X2", "0805"), ("DIV2K_valid_LR_bicubic/X2", "0802"), ("X2", "0802"), ("X2", "1000")):
        save_image(tmp_path / "div2k" / folder / f"{scene}x2.png", PICTURE)
    subset = open_dataset("div2k-subset", data_root=tmp_path)
    assert (subset.name, tuple(subset.scenes())) == ("div2k-subset", ("0802", "0805"))
    with pytest.raises(
        Unavailable, match=r"(?s)2 of the 100.*0801x2\.png.*bench download div2k, or --dataset div2k-subset"
    ):
        open_dataset("div2k", data_root=tmp_path).scenes()
    with pytest.raises(Unknown, match="0806"):
        subset.load("0806")
    with pytest.raises(Unavailable, match=r"tcmonodepth_small_384\.onnx"):
        subset.load("0805")


def test_all_hundred(tmp_path: Path) -> None:
    for scene in SCENES:
        path = tmp_path / "div2k" / "X2" / f"{scene}x2.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    for name in ("div2k", "div2k-subset"):
        assert tuple(open_dataset(name, data_root=tmp_path).scenes()) == SCENES
    assert {"div2k", "div2k-subset"} <= set(DATASETS)


def test_real_images_with_the_network(data_root: Path) -> None:
    dataset = open_dataset("div2k-subset", data_root=data_root)
    assert len(dataset.scenes()) == 14
    case = dataset.load("0896")  # sky-dominated
    assert case.depth.shape == case.image.shape[:2] == (case.camera.height, case.camera.width)
    assert case.dataset == "div2k-subset"
    assert "tcmonodepth" in case.depth_source
    assert not case.depth_is_metric
    assert np.isfinite(case.depth).all()
    assert len(case.eval_indices) == 50
    low, high = np.percentile(case.depth, (5, 95))
    assert 0.1 < high - low < 3  # in scene radii


@pytest.fixture
def run(tmp_path: Path) -> Measured:
    fakes.reset()
    fakes.SWITCHES["dark b"] = "crash"
    methods = tuple(fakes.METHODS)
    request = RunRequest(fakes.FakeDataset(), ("a", "b", "c"), methods, ("bright",), tmp_path / "run")
    run_bench(request, methods=fakes.METHODS, metrics=fakes.METRICS)
    fakes.reset()
    return read_runs([tmp_path / "run"])


def test_a_failure_by_both_rules(run: Measured) -> None:
    """Counted: the failing method's mean misses a scene and says so. The paper's rule: nobody is scored on it."""
    assert failed_anywhere(run) == ("b",)
    kept = without_failed_anywhere(run)
    assert kept.scenes == ("a", "c")
    assert "2 of 3 scenes" in kept.caption[-1]
    assert kept.caption[-1].endswith("failed on it: b.")
    assert kept.methods == run.methods
    text = dataset_table(run).to_markdown()
    assert "(2/3)" in text
    assert "(2/3)" not in dataset_table(kept).to_markdown()


def test_nothing_failed(run: Measured) -> None:
    clean = dataclasses.replace(run, scenes=("a", "c"))
    assert failed_anywhere(clean) == ()
    assert without_failed_anywhere(clean).scenes == ("a", "c")
    assert "left out for every method, because one failed on it: none" in without_failed_anywhere(clean).caption[-1]


def test_a_failed_metric_is_no_failed_method(tmp_path: Path) -> None:
    fakes.reset()
    fakes.SWITCHES["bright"] = "crash"
    request = RunRequest(fakes.FakeDataset(), ("a",), ("dark",), ("bright",), tmp_path / "run")
    run_bench(request, methods=fakes.METHODS, metrics=fakes.METRICS)
    fakes.reset()
    assert failed_anywhere(read_runs([tmp_path / "run"])) == ()


def test_both_tables_on_the_command_line(run: Measured, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["table", str(tmp_path / "run"), "--exclude-failed-anywhere", "--format", "markdown"]) == 0
    text = capsys.readouterr().out
    assert "fake: mean over 3 scenes" in text
    assert "fake: mean over 2 scenes, the paper's rule" in text
