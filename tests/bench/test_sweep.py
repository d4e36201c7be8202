"""A sweep from the command line: points are cells of a run, computed once, and end in a chart."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from bench.cli import main
from bench.commands import sweep
from bench.datasets.synthetic import Synthetic
from bench.store import RunStore
from orca.images import save_image

METHODS = "orca@anchors=400+repair=off,orca@anchors=1200+repair=off,warp"


@pytest.mark.slow
def test_points_are_computed_once_and_charted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    case = Synthetic(size=64).load("predictable-03")
    save_image(tmp_path / "images" / "scene.png", case.image)
    np.save(tmp_path / "images" / "scene.depth.npy", case.depth)
    warmed: list[str] = []
    monkeypatch.setattr(sweep, "_warm_up", warmed.append)
    asked = ["sweep", "--dataset", "folder", "--images", str(tmp_path / "images"), "--out", str(tmp_path / "run")]
    asked += ["--methods", METHODS, "--metrics", "input_psnr,hole_fraction", "--json"]
    assert main(asked) == 0
    first = json.loads(capsys.readouterr().out)
    assert (first["run"]["computed"], warmed) == (3, ["cpu"])
    store = RunStore(tmp_path / "run")
    memory = {record.method: record.timing["memory"] for record in store.records()}
    assert set(memory) == set(METHODS.split(","))
    assert all(set(m) == {"before_mb", "peak_mb"} for m in memory.values())
    few, many = (store.load(name, "scene") for name in METHODS.split(",")[:2])
    assert few is not None
    assert many is not None
    assert few.model["anchors"] < many.model["anchors"]
    assert few.scores["input_psnr"].value < many.scores["input_psnr"].value  # type: ignore[operator]
    before = {path: path.read_bytes() for path in store.record_paths()}

    assert main(asked) == 0
    second = json.loads(capsys.readouterr().out)
    assert (second["run"]["computed"], warmed) == (0, ["cpu"])  # nothing to do, so nothing is warmed up either
    assert {path: path.read_bytes() for path in store.record_paths()} == before
    assert first["chart"]["panels"] == second["chart"]["panels"]
    assert (tmp_path / "run" / "chart" / "chart-seconds.png").is_file()
    assert main(["verify", str(tmp_path / "run")]) == 0
    assert main(["table", str(tmp_path / "run"), "--format", "latex"]) == 0
    assert r"anchors=400+repair=off" in capsys.readouterr().out


def test_a_wrong_point_is_refused_before_any_work(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "run"
    assert main(["sweep", "--methods", "orca@anchor=400,warp", "--out", str(out)]) == 2
    assert "did you mean 'anchors'" in capsys.readouterr().err
    assert not out.exists()
