"""The speed bench on a thumbnail: every case runs, backends see the same frame, memory is that of a process."""

from __future__ import annotations

import csv
import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import bench.commands.speed as speed_verb
from bench.cli import main
from bench.datasets.case import SceneCase
from bench.speed.case import BACKENDS, CaseName, Mode, Setting
from bench.speed.chart import write_chart, write_csv
from bench.speed.initialisation import fit_curve
from bench.speed.measure import measure, measure_setting
from bench.speed.memory import own_peak_mb, peak_mb
from bench.speed.threads import available_threads, limited_to
from bench.speed.timing import Patience
from bench.speed.trainers import trained_backends
from bench.speed.works import FrameWork
from bench.speed.workshop import Workshop
from orca.config import get_preset
from tests.bench.small_cases import make_case, noise_image, plane

WIDTH = 48
ONCE = Patience(warmup=0, repeats=1, least=1, seconds=0.0)
MODES: tuple[Mode, ...] = ("layered", "per-hit")


def setting(case: CaseName, mode: Mode = "layered") -> Setting:
    return Setting(case, mode, WIDTH**2 // 4, WIDTH, 1, BACKENDS[case], ONCE, ())


@pytest.fixture(scope="module")
def workshop(tmp_path_factory: pytest.TempPathFactory) -> Workshop:
    return Workshop(tmp_path_factory.mktemp("speed"), WIDTH)


@pytest.mark.parametrize("mode", MODES)
def test_a_frame_is_timed_by_both_and_is_the_same(workshop: Workshop, mode: Mode) -> None:
    rows, ratio = measure_setting(setting("frame", mode), workshop)
    assert [row.backend for row in rows] == ["fast", "reference"]
    for row in rows:
        assert row.wall_ms > 0
        assert row.cpu_ms > 0
        assert row.psnr is not None
        assert 1 < float(row.facts["hits_per_ray"] or 0) < 9
        assert abs(float(row.facts["anchors"] or 0) - WIDTH**2 / 4) < 0.05 * WIDTH**2
    assert ratio is not None
    assert ratio.largest_difference is not None
    assert 0 < ratio.largest_difference < 1e-3
    assert ratio.wall == rows[1].wall_ms / rows[0].wall_ms


def test_every_round_has_a_camera_of_its_own(workshop: Workshop) -> None:
    work = FrameWork(setting("frame"), "fast", workshop)
    frames = []
    for number in range(9):
        work(number)
        assert work.rgb is not None
        frames.append(work.rgb)
    assert all(np.abs(a - b).max() > 1e-3 for i, a in enumerate(frames) for b in frames[:i])


def test_the_scene_is_made_once_and_kept_for_other_processes(workshop: Workshop) -> None:
    scene = workshop.scene(WIDTH**2 // 4, "layered")
    assert workshop.scene(WIDTH**2 // 4, "layered") is scene
    elsewhere = Workshop(workshop.folder, WIDTH).scene(WIDTH**2 // 4, "layered")
    assert elsewhere.anchors.means.equal(scene.anchors.means)


@pytest.mark.slow
def test_fit_step_and_repair_are_timed(workshop: Workshop) -> None:
    rows, ratios = measure([setting(case) for case in ("fit", "step", "stage3")], workshop)
    by_case = {row.case: row for row in rows}
    assert by_case["fit"].psnr is not None
    assert by_case["fit"].psnr > 15
    assert by_case["step"].facts["batch_rays"] == 4096
    assert int(by_case["stage3"].facts["repairs"] or 0) >= 1
    assert {row.backend for row in rows if row.case == "step"} == set(trained_backends())
    assert all(row.wall_ms > 0 and row.repeats == 1 for row in rows)
    assert len(ratios) == len(trained_backends()) - 1


def test_rows_are_told_as_they_come(workshop: Workshop) -> None:
    heard: list[int] = []
    measure([setting("frame")] * 2, workshop, lambda rows: heard.append(len(rows)))
    assert heard == [2, 4]


def test_threads_are_limited_and_come_back() -> None:
    import cv2
    import numba
    import torch

    def now() -> tuple[int, int, int]:
        return numba.get_num_threads(), torch.get_num_threads(), cv2.getNumThreads()

    before = now()
    with limited_to(1):
        assert now() == (1, 1, 1)
    assert now() == before
    assert available_threads() >= 1


@pytest.mark.slow
def test_peak_memory_is_that_of_a_fresh_process(workshop: Workshop) -> None:
    """However much this one holds: an import of torch and a thumbnail stay under a gigabyte."""
    workshop.scene(WIDTH**2 // 4, "layered")
    ballast = np.ones(130_000_000)  # a gigabyte, touched
    peak = peak_mb(setting("frame"), "fast", workshop.folder, WIDTH)
    mine = own_peak_mb()
    assert peak is not None
    assert mine is not None
    assert 100 < peak < 1000 < mine
    assert ballast.sum() == len(ballast)


@pytest.fixture
def thumbnail_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    """The verb on a plan of one tiny frame."""
    monkeypatch.setattr(speed_verb, "_plan", lambda cases, quick: tuple(setting(case) for case in cases))
    monkeypatch.setattr(speed_verb, "Workshop", lambda folder: Workshop(folder, WIDTH))


@pytest.mark.usefixtures("thumbnail_plan")
def test_the_verb_prints_a_table_and_writes_rows(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["speed", "--cases", "frame", "--json", "--out", str(tmp_path)]) == 0
    document = json.loads(capsys.readouterr().out)
    wanted = {"case", "backend", "mode", "anchors", "width", "threads", "wall_ms", "cpu_ms", "peak_mb", "psnr"}
    assert all(wanted <= set(row) for row in document["rows"])
    assert document["machine"]["cores"] >= 1
    assert json.loads((tmp_path / "speed.json").read_text()) == document
    assert "### Speed" in (tmp_path / "speed.md").read_text()
    assert main(["speed", "--cases", "frame"]) == 0
    text = capsys.readouterr().out
    assert "x the reference" in text
    assert "Wall [ms]" in text


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["--cases", "fram"], "did you mean 'frame'?"),
        (["--cases", "init", "--iterations", "-1"], "--iterations -1"),
        (["--cases", "init", "--scenes", "chelse"], "did you mean 'chelsea'?"),
    ],
)
def test_bad_input_is_exit_code_2(argv: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["speed", *argv]) == 2
    assert words in capsys.readouterr().err


def small_case() -> SceneCase:
    return make_case(noise_image(32, 32), plane(32, 32), [np.eye(4)])


def test_both_initialisations_make_a_curve_and_a_chart(tmp_path: Path) -> None:
    curves = [fit_curve(small_case(), name, 4) for name in ("closed_form", "random")]
    closed, random = curves
    steps = get_preset("draft").planar.gauss_newton_steps
    assert [p.solver_steps for p in closed.points][:steps] == list(range(1, steps + 1))
    assert [p.iterations for p in random.points] == [0, 1, 2, 3, 4]
    assert closed.points[steps - 1].psnr > random.points[-1].psnr + 3
    for curve in curves:
        trained = [p for p in curve.points if p.iterations > 0]
        assert len(trained) == 4
        assert all(a.cpu_s < b.cpu_s for a, b in pairwise(trained))
    write_csv(curves, tmp_path / "curves.csv")
    with (tmp_path / "curves.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert len(lines) == sum(len(curve.points) for curve in curves)
    assert float(lines[0]["psnr_db"]) == pytest.approx(closed.points[0].psnr, abs=1e-3)
    write_chart(curves, tmp_path / "curves.png")
    assert (tmp_path / "curves.png").read_bytes()[:4] == b"\x89PNG"
