"""Whole scenes as they are timed, and TSED against naive OpenCV: rows, tables, the verb. No timed claims."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import bench.commands.speed as speed_verb
from bench.cli import main
from bench.datasets.catalogue import open_dataset
from bench.metrics.tsed_speed import TsedSpeed
from bench.speed.consistency import measure_consistency, tsed_line
from bench.speed.scenes import SceneJob, SceneRow, inputs_of, measure_scenes, measured, scenes_table
from bench.speed.workshop import Workshop
from tests.bench.small_cases import noise_image

SIDE = 72
WANTED = {"case", "backend", "mode", "anchors", "width", "threads", "wall_ms", "cpu_ms", "peak_mb", "psnr"}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two small pictures as a data set."""
    images = tmp_path / "images"
    images.mkdir()
    for name, seed in (("first", 0), ("second", 1)):
        smooth = cv2.GaussianBlur(noise_image(SIDE, SIDE, seed), (0, 0), 2.0)
        cv2.imwrite(str(images / f"{name}.png"), smooth)
    return images


def row(scene: str = "a", case: str = "fit") -> SceneRow:
    seconds = {"canvas": 0.5, "planar": 1.0, "deform": 0.25, "repair": 0.0}
    return SceneRow(
        case, "fast", "layered", scene, 65536, 69000, 512, 2, 3, 1750.0, 2500.0, 900.0, 36.5, seconds
    )  # fmt: skip


def test_the_whole_method_is_measured_by_stage(folder: Path) -> None:
    case = open_dataset("folder", data_root=None, images=folder).load("first")
    job = SceneJob("first", inputs_of(case), "reconstruct", "draft", 1, 1)
    short = replace(job, inputs=replace(job.inputs, views=job.inputs.views[::10]))
    found = measured(short)
    assert (found.case, found.anchors, found.width, found.threads, found.repeats) == (
        "reconstruct", SIDE**2 // 4, SIDE, 1, 1
    )  # fmt: skip
    assert sum(found.seconds.values()) <= found.wall_ms / 1e3
    assert found.seconds["repair"] > 0
    assert found.psnr > 20
    fit = measured(replace(short, case="fit"))
    assert fit.seconds["repair"] < 0.01
    assert fit.placed <= found.placed


@pytest.mark.slow
def test_every_row_is_of_a_process_of_its_own(folder: Path) -> None:
    case = open_dataset("folder", data_root=None, images=folder).load("first")
    ballast = np.ones(130_000_000)  # a gigabyte, touched
    heard: list[SceneRow] = []
    rows = measure_scenes([case], 1, True, heard.append)
    assert [(r.case, r.anchors) for r in rows] == [("fit", SIDE**2 // 4), ("fit", SIDE**2)]
    assert rows == heard
    assert rows[1].psnr > rows[0].psnr
    assert all(r.peak_mb is not None and 100 < r.peak_mb < 1000 for r in rows)
    assert ballast.sum() == len(ballast)


def test_the_table_groups_scenes() -> None:
    text = scenes_table([row("a"), row("a", "reconstruct"), row("b")]).to_markdown()
    assert "| a | fit | 65536 | 512 | 2 | 1.75 | 2.50 | 0.50 | 1.00 | 0.25 | 0.00 | 900 | 36.50 | 69000 |" in text
    without = scenes_table([replace(row(), peak_mb=None)]).to_markdown()
    assert "| - | 36.50 |" in without


def test_the_verb_adds_rows_of_scenes(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: list[tuple[list[str], bool]] = []

    def fake(cases, threads, quick, done):  # type: ignore[no-untyped-def]
        asked.append(([case.name for case in cases], quick))
        rows = [row(case.name) for case in cases]
        for one in rows:
            done(one)
        return rows

    monkeypatch.setattr("bench.speed.scenes.measure_scenes", fake)
    where = ["--dataset", "folder", "--images", str(folder), "--out", str(tmp_path / "out"), "--json"]
    assert main(["speed", "--cases", "scenes", *where]) == 0
    document = json.loads(capsys.readouterr().out)
    assert asked == [(["first", "second"], False)]
    assert [r["scene"] for r in document["rows"]] == ["first", "second"]
    assert all(set(r) >= WANTED for r in document["rows"])
    assert json.loads((tmp_path / "out" / "scenes.json").read_text())["rows"] == document["rows"]
    assert "### Whole scenes" in (tmp_path / "out" / "scenes.md").read_text()
    assert main(["speed", "--cases", "scenes", "--quick", *where]) == 0
    assert main(["speed", "--cases", "scenes", "--scenes", "second", *where]) == 0
    assert asked[1:] == [(["first"], True), (["second"], False)]


def test_tsed_is_compared_on_rendered_frames(tmp_path: Path) -> None:
    found = measure_consistency(Workshop(tmp_path, 96), 1, 1, frames=3, anchors=96**2 // 4)
    assert (found.frames, found.width, found.height, found.differing_pairs) == (3, 96, 96, 0)


def test_the_line_of_tsed_says_what_was_compared(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    speed = TsedSpeed(50, 512, 512, 2, (2.0, 2.5), (20.0, 30.0), (4.0, 4.0), (20.0, 24.0), 0)
    assert tsed_line(speed) == (
        "TSED, 50 frames of 512x512, 2 thread(s): 2.25 s; naive OpenCV (both frames of every pair detected anew, brute "
        "force both ways) 25.00 s: 11.0x (CPU 5.5x), all verdicts the same"
    )
    assert "3 pairs differ" in tsed_line(replace(speed, differing_pairs=3))
    monkeypatch.setattr("bench.speed.consistency.measure_consistency", lambda *arguments: speed)
    monkeypatch.setattr(speed_verb, "host_facts", lambda: {"cpu": "c", "cores": 2, "memory_gib": 1})
    assert main(["speed", "--cases", "tsed", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["tsed"]["ratio"] == speed.ratio
