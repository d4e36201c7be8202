"""Curves of quality against disturbance: what is disturbed, what stays true, and what is kept."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench.adapters import METHODS, RunOptions
from bench.cli import main
from bench.datasets.case import SceneCase, TrueView
from bench.metrics.fidelity import mean_squared_error
from bench.stability.curvechart import curves_csv, curves_text
from bench.stability.curves import CurveJob, CurveRows, seed_spread
from bench.stability.disturb import DISTURBANCES, disturbed, reduced, seed_of
from bench.stability.scenes import make_scene
from orca.camera import Camera
from orca.errors import BadInput, Unknown


@pytest.fixture
def case() -> SceneCase:
    """A generated scene with one true view from the right."""
    scene = make_scene()
    pose = np.eye(4)
    pose[0, 3] = -0.1
    other = Camera(scene.camera.K, pose, scene.camera.width, scene.camera.height)
    truth = TrueView(other, np.asarray(scene.image[:, ::-1]), np.zeros(scene.image.shape[:2], bool))
    return replace(scene, true_views=(truth,), depth_is_measured=True)


@pytest.mark.parametrize("kind", DISTURBANCES)
def test_the_first_level_disturbs_nothing(kind: str, case: SceneCase) -> None:
    told = disturbed(case, kind, DISTURBANCES[kind].levels[0])
    np.testing.assert_array_equal(told.image, case.image)
    np.testing.assert_array_equal(told.depth, case.depth)
    np.testing.assert_array_equal(told.camera.K, case.camera.K)
    assert told.depth_is_measured


@pytest.mark.parametrize("kind", DISTURBANCES)
def test_the_truth_stays(kind: str, case: SceneCase) -> None:
    told = disturbed(case, kind, DISTURBANCES[kind].levels[-1])
    inside, second = told.true_views
    np.testing.assert_array_equal(inside.image, case.image)
    np.testing.assert_array_equal(inside.camera.K, case.camera.K)
    assert second is case.true_views[0]
    assert told.trajectory is case.trajectory


def test_each_disturbance_does_what_it_says(case: SceneCase) -> None:
    np.testing.assert_allclose(disturbed(case, "scale", 1.25).depth, 1.25 * case.depth, rtol=1e-6)
    focal = disturbed(case, "fov", -10).camera.K
    assert focal[0, 0] == pytest.approx(0.9 * case.camera.K[0, 0])
    assert focal[0, 2] == case.camera.K[0, 2]
    ratio = np.log(disturbed(case, "noise", 10).depth / case.depth)
    assert ratio.std() == pytest.approx(math.log(1.1), rel=1e-3)
    assert not disturbed(case, "noise", 10).depth_is_measured
    losses = [mean_squared_error(disturbed(case, "jpeg", q).image, case.image) for q in (90, 50, 10)]
    assert 0 < losses[0] < losses[1] < losses[2]
    assert [seed_of("seed", 3), seed_of("noise", 3)] == [3, 0]
    with pytest.raises(Unknown, match="noise, scale"):
        disturbed(case, "nois", 1)


def test_a_reduced_case_sees_the_same(case: SceneCase) -> None:
    half = reduced(case, 0.5)
    assert half.image.shape == (64, 64, 3)
    assert half.depth.shape == half.true_views[0].hidden.shape == (64, 64)
    points = np.array([[0.1, -0.2, 2.0], [0.4, 0.3, 1.0]])
    for before, after in (
        (case.camera, half.camera),
        (case.trajectory.camera(2), half.trajectory.camera(2)),
        (case.true_views[0].camera, half.true_views[0].camera),
    ):
        np.testing.assert_allclose(after.project(points)[0], before.project(points)[0] / 2)
    assert set(np.unique(half.depth)) <= set(np.unique(case.depth)), "no depth between two surfaces"
    assert reduced(case, 1.0) is case


def row(kind: str, level: float, second: float, method: str = "m") -> dict[str, object]:
    return {
        "disturbance": kind,
        "level": level,
        "method": method,
        "input_psnr": 30.0,
        "second_psnr": second,
        "outcome": "exact",
        "detail": "",
        "seconds": 1.0,
        "cpu_s": 1.0,
    }


def test_the_spread_over_seeds_is_the_sample_standard_deviation() -> None:
    rows = [row("seed", 0, 20.0), row("seed", 1, 21.0), row("seed", 2, 22.0), row("noise", 0, 99.0)]
    assert seed_spread(rows, "m") == {"input_psnr": 0.0, "second_psnr": 1.0}
    assert seed_spread(rows[:1], "m") == {}
    assert "standard deviation over 3 seeds: input view 0.000 dB, second view 1.000 dB" in curves_text(rows)
    assert curves_csv(rows).splitlines()[1] == "seed,0,m,30,20,exact,,1,1"


def test_points_are_kept(tmp_path: Path) -> None:
    job = CurveJob("noise", 5.0, "warp")
    rows = CurveRows(tmp_path)
    assert rows.get(job, "v1") is None
    rows.add(job, "v1", {"second_psnr": 20.0})
    again = CurveRows(tmp_path)
    assert again.get(job, "v1") == {
        "disturbance": "noise",
        "level": 5.0,
        "method": "warp",
        "version": "v1",
        "second_psnr": 20.0,
    }
    assert again.get(job, "v2") is None
    (tmp_path / "curves.json").write_text('{"rows": [{}]}')
    with pytest.raises(BadInput, match="broken row"):
        CurveRows(tmp_path)


def test_a_method_that_fails_is_a_point(monkeypatch: pytest.MonkeyPatch) -> None:
    class Broken:
        def run(self, case: SceneCase, options: RunOptions) -> None:
            raise ValueError("no")

    monkeypatch.setattr(type(METHODS), "get", lambda self, name: Broken())
    done = CurveJob("noise", 0.0, "warp").run()
    assert (done.verdict.outcome, done.verdict.detail) == ("crash", "ValueError: no")


def test_a_folder_holds_the_curves_of_one_scene(tmp_path: Path) -> None:
    CurveRows(tmp_path, "synthetic/predictable-00").add(CurveJob("noise", 5.0, "warp"), "v1", {"second_psnr": 20.0})
    assert len(CurveRows(tmp_path, "synthetic/predictable-00").rows()) == 1
    with pytest.raises(BadInput, match="of the scene 'synthetic/predictable-00'"):
        CurveRows(tmp_path)


@pytest.mark.parametrize("scene", ["motorcycle", "photos/rocket", "photos/nowhere", "nowhere/motorcycle"])
def test_a_scene_without_truth_is_refused(scene: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["stability", "--curves", "scale", "--methods", "warp", "--scene", scene]) == 2
    assert "to do:" in capsys.readouterr().err


def test_a_synthetic_scene_is_judged_at_all_its_true_views() -> None:
    """A warp knows its input, and the exact depth leads to better novel views than a wrong one."""
    done = [CurveJob("scale", level, "warp-telea", scene="synthetic/predictable-00").run() for level in (1.0, 1.25)]
    exact, wrong = (d.verdict.numbers for d in done)
    assert exact["input_psnr"] == wrong["input_psnr"] == 99.0
    assert exact["second_psnr"] > wrong["second_psnr"] + 1


@pytest.mark.slow
def test_the_verb_on_motorcycle(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["stability", "--curves", "scale", "--methods", "warp-telea", "--out", str(tmp_path), "--json"]
    assert main(words) == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    second = {row["level"]: row["second_psnr"] for row in rows}
    assert list(second) == [0.8, 0.9, 1.0, 1.1, 1.25]
    assert second[1.0] > second[0.9] > second[0.8]
    assert second[1.0] > second[1.1] > second[1.25]
    assert (tmp_path / "curves.png").read_bytes()[:4] == b"\x89PNG"
    assert main(["stability", "--curves", "scle"]) == 2
