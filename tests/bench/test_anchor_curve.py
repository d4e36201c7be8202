"""``bench anchors``: the curve's arithmetic by hand, and one small measurement from the command line."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from bench.anchorcurve import CurvePoint, Goal, SceneCurve, needed
from bench.cli import main
from bench.datasets.case import SceneCase


def curve(*grown: tuple[int, float]) -> SceneCurve:
    grids = [CurvePoint("grid", n, db, 1.0, 10.0) for n, db in ((25_000, 28.0), (50_000, 31.0), (100_000, 90.0))]
    points = [CurvePoint("grown", n, db, 1.0, 10.0) for n, db in grown]
    points[-1] = replace(points[-1], placement="target")
    points.append(replace(points[0], placement="knee", why="a thousand anchors gained 0.03 dB"))
    return SceneCurve("a", 40.0, 0.1, (*grids, *points))


def noisy_square(folder: Path) -> Path:
    """A folder with one picture: a square of noise on a grey wall."""
    images = folder / "images"
    images.mkdir()
    image = np.full((64, 64, 3), 90, np.uint8)
    image[10:40, 10:40] = np.random.default_rng(0).integers(0, 256, (30, 30, 3))
    cv2.imwrite(str(images / "a.png"), image)
    return images


def test_what_a_quality_needs_lies_on_a_straight_line_between_points() -> None:
    measured = curve((10_000, 30.0), (20_000, 35.0), (30_000, 45.0))
    assert needed(measured, 32.0) == pytest.approx(14_000)
    assert needed(measured, 40.0) == pytest.approx(25_000)
    assert needed(measured, 20.0) == 10_000
    assert needed(measured, 45.1) is None


def test_points_are_found_by_their_share_of_the_pixels() -> None:
    measured = curve((10_000, 30.0), (24_990, 35.0))
    assert [measured.grid(s).anchors for s in (0.25, 0.5, 1.0)] == [25_000, 50_000, 100_000]
    assert measured.grown_at(0.25).anchors == 24_990


@pytest.mark.parametrize(("target", "price", "why"), [(25.0, 0.1, "target"), (60.0, 20.0, "price")])
def test_the_knee_is_where_growing_stops_by_itself(tmp_path: Path, target: float, price: float, why: str) -> None:
    out = tmp_path / "out"
    limits = ["--target-psnr", str(target), "--price", str(price)]
    assert (
        main(["anchors", "--dataset", "folder", "--images", str(noisy_square(tmp_path)), "--out", str(out), *limits])
        == 0
    )
    with (out / "anchors.csv").open() as file:
        rows = {row["placement"]: row for row in csv.DictReader(file)}
    knee, reached = rows["knee"], rows["target"]
    assert f" dB ({why}) |" in (out / "README.md").read_text()
    if why == "target":
        assert float(knee["psnr_db"]) >= target - 0.01
    else:
        assert int(knee["anchors"]) < int(reached["anchors"])
        assert "less than their price of 20" in knee["why"]


def test_the_command_writes_chart_figures_and_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    images, out = noisy_square(tmp_path), tmp_path / "out"
    code = main(["anchors", "--dataset", "folder", "--images", str(images), "--out", str(out), "--json"])
    document = json.loads(capsys.readouterr().out)
    assert code == 0
    (scene,) = document["scenes"]
    with (out / "anchors.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(scene["points"])
    grown = {int(r["anchors"]): float(r["psnr_db"]) for r in rows if r["placement"] == "grown"}
    assert [round(n / 64 / 64, 2) for n in grown][:3] == [0.06, 0.12, 0.25]
    assert list(grown.values()) == sorted(grown.values())
    (reached,) = [row for row in rows if row["placement"] == "target"]
    assert float(reached["psnr_db"]) >= 39.99  # as rendered; growing goes by what it solved
    assert int(reached["anchors"]) < 64 * 64
    assert (out / "anchors.png").stat().st_size > 1000
    page = (out / "README.md").read_text()
    assert page.count("\n| a |") == 1
    assert "Mean gain at equal count" in page


def test_what_is_measured_is_read_and_not_measured_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import bench.commands.anchors as command

    images, out = tmp_path / "images", tmp_path / "out"
    images.mkdir()
    for name in "ab":
        cv2.imwrite(str(images / f"{name}.png"), np.full((32, 32, 3), 90, np.uint8))
    asked: list[str] = []

    def measured(case: SceneCase, config: object, goal: Goal) -> SceneCurve:
        asked.append(case.name)
        return replace(
            curve((10_000, 30.0), (25_000, 41.25)), scene=case.name, target_db=goal.psnr_db, price_db=goal.price
        )

    monkeypatch.setattr(command, "measure_curve", measured)
    arguments = ["anchors", "--dataset", "folder", "--images", str(images), "--out", str(out), "--json"]
    documents = []
    for more in (["--scenes", "a"], [], ["--target-psnr", "41"], ["--price", "0.2"]):
        monkeypatch.setattr(command, "_draw", lambda path, curves, goal: None)
        assert main([*arguments, *more]) == 0
        documents.append(json.loads(capsys.readouterr().out))
    assert asked == ["a", "b"] * 3  # again for another target and another price only
    assert documents[1]["scenes"][0] == documents[0]["scenes"][0]


def test_a_file_of_another_kind_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "anchors.csv").write_text("x,y\n1,2\n")
    assert main(["anchors", "--out", str(tmp_path)]) == 2
    assert "choose another folder" in capsys.readouterr().err


@pytest.mark.parametrize("flags", [["--price", "0"], ["--target-psnr", "-1"], ["--scenes", "nowhere"]])
def test_what_makes_no_sense_is_refused(flags: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["anchors", *flags]) == 2
    assert "error:" in capsys.readouterr().err
