"""The command line: what it writes, what it prints where, and how it refuses."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch

from orca import pipeline
from orca.anchors import GaussianAnchors
from orca.camera import Camera
from orca.cli import main
from orca.config import ReconstructConfig, RenderConfig
from orca.export import read_ply
from orca.field.decoders import analytic_decoders
from orca.images import load_image, save_image
from orca.paths import make_path
from orca.pipeline import Reconstruction
from orca.placement import choose_field_of_view, path_in_scene_radii
from orca.priors.depth import DepthEstimate
from orca.scene import Scene
from orca.video import read_video

SIZE = 32
FILES = {"scene.safetensors", "preview.mp4", "preview.png", "ledger.json", "config.json", "timings.json"}


def small_scene(camera: Camera) -> Scene:
    """One wide red Gaussian in front of the camera."""
    features = torch.zeros(1, 32)
    features[0, :4] = torch.tensor([3.0, -3.0, -3.0, 1.0])
    anchors = GaussianAnchors(
        means=torch.tensor([[0.0, 0.0, 1.0]]),
        log_variances=torch.full((1, 3), -2.0),
        quaternions=torch.tensor([[1.0, 0.0, 0.0, 0.0]]),
        opacity_logits=torch.ones(1),
        features=features,
        stage=torch.zeros(1, dtype=torch.uint8),
    )
    return Scene(anchors, analytic_decoders(30.0, torch.Generator().manual_seed(0)), RenderConfig(), camera)


@pytest.fixture
def image(tmp_path: Path) -> Path:
    path = tmp_path / "in.png"
    save_image(path, np.random.default_rng(0).integers(0, 256, (SIZE, SIZE, 3), dtype=np.uint8))
    return path


@pytest.fixture
def scene_file(tmp_path: Path) -> Path:
    path = tmp_path / "s.safetensors"
    small_scene(Camera.from_fov(SIZE, SIZE, 60)).save(path)
    return path


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """The method replaced by a scene that is there at once; each call's arguments are kept."""
    seen: list[dict[str, Any]] = []

    def fake(
        image: np.ndarray, camera: Camera, depth: DepthEstimate, trajectory: Any, config: Any, **rest: Any
    ) -> Reconstruction:
        seen.append({"camera": camera, "depth": depth, "trajectory": trajectory, "config": config, **rest})
        rest["progress"]("planar fit", 1, 1)
        record: dict[str, Any] = {"seconds": {"planar": 0.5}, "input_psnr": {"final": 30.0}, "anchors": {"original": 1}}
        record["growth"] = {"stopped": "the preset's count", "curve": []}
        record["priors"] = {"outpainter": "mirror", "inpainter": "classical", "depth": "none"}
        record |= {"margins": [24, 0, 3, 0], "canvas_scale": [59 / 32, 1.0]}
        record["history"] = {"planar fit": {"stopped": "early_stopping", "iterations": 60, "evaluations": []}}
        ledger = {"schema_version": 1, "repairs": [], "stopped": "nothing is left"}
        return Reconstruction(small_scene(camera), ledger, record)

    monkeypatch.setattr(pipeline, "reconstruct", fake)
    return seen


def run(*arguments: object) -> int:
    return main([str(a) for a in arguments])


def test_help_imports_nothing_heavy() -> None:
    heavy = "[m for m in ('numpy', 'torch', 'cv2') if m in sys.modules]"
    code = f"import sys, orca.cli as c; c.build_parser(); print({heavy})"
    result = subprocess.run([sys.executable, "-m", "orca", "--help"], capture_output=True, text=True, check=True)
    assert "reconstruct" in result.stdout
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert loaded.stdout.strip() == "[]"


def test_reconstruct_writes_every_file(
    image: Path, tmp_path: Path, calls: list[dict[str, Any]], capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "new" / "folder"
    assert run("reconstruct", image, "--out", out, "--frames", 5, "--depth", "constant?z=4", "--json") == 0
    assert {p.name for p in out.iterdir()} == FILES
    document = json.loads(capsys.readouterr().out)
    assert document["anchors"] == 1
    assert set(document["files"]) == FILES
    assert {"depth", "planar", "preview"} <= set(document["seconds"])
    assert document["stopped"] == {
        "growth": "the preset's count",
        "training": {"planar fit": "early_stopping after 60 iterations"},
        "repair": "nothing is left",
    }
    expected = {"scale": [59 / 32, 1.0], "limit": 2.5, "margins": [24, 0, 3, 0], "sides_at_limit": ["left"]}
    assert document["canvas"] == expected
    assert read_video(out / "preview.mp4").shape == (5, SIZE, SIZE, 3)
    assert load_image(out / "preview.png").shape[1] == 3 * SIZE
    settings = json.loads((out / "config.json").read_text())
    assert settings["name"] == "draft"
    assert settings["run"]["depth_source"] == "constant 4"
    assert settings["run"]["hfov_source"].startswith("assumed")
    assert Scene.load(out / "scene.safetensors").provenance["unit"] == "R"


def test_depth_and_path_are_in_scene_radii(image: Path, tmp_path: Path, calls: list[dict[str, Any]]) -> None:
    for name, z in (("a", 1), ("b", 1000)):
        run("reconstruct", image, "--out", tmp_path / name, "--frames", 3, "--depth", f"constant?z={z}")
    one, thousand = calls
    np.testing.assert_allclose(one["depth"].depth, thousand["depth"].depth, rtol=1e-5)
    np.testing.assert_array_equal(one["trajectory"][1].world_to_camera, make_path("spiral", 3)[1])


def test_choices_reach_the_method(image: Path, tmp_path: Path, calls: list[dict[str, Any]]) -> None:
    run(
        *("reconstruct", image, "--out", tmp_path / "o", "--frames", 2, "--depth", "constant", "--hfov", 40),
        *("--preset", "paper", "--lifting", "metric", "--outpaint", "none", "--seed", 7, "--trajectory", "dolly"),
    )
    config: ReconstructConfig = calls[0]["config"]
    assert (config.name, config.deform.lifting, config.canvas.outpainter) == ("paper", "metric", "none")
    assert calls[0]["camera"].hfov_deg == pytest.approx(40)
    assert calls[0]["seed"] == 7
    run("reconstruct", image, "--out", tmp_path / "o", "--frames", 2, "--depth", "constant", "--preset", "paper")
    assert calls[1]["config"].deform.lifting == "relative"


def test_a_depth_file_beside_the_image_is_used_and_else_a_loud_guess(
    image: Path, tmp_path: Path, calls: list[dict[str, Any]], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("reconstruct", image, "--out", tmp_path / "o", "--frames", 2) == 0
    assert calls[0]["depth"].source == "heuristic (no network)"
    assert "guessed" in capsys.readouterr().out
    np.save(tmp_path / "in_depth.npy", np.full((SIZE, SIZE), 3.0))
    run("reconstruct", image, "--out", tmp_path / "o", "--frames", 2)
    assert calls[1]["depth"].source == "file in_depth.npy (depth)"


def test_render_info_and_export(scene_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    video = tmp_path / "v" / "x.mp4"
    assert run("render", scene_file, "--trajectory", "swing", "--frames", 4, "--out", video, "--json") == 0
    assert json.loads(capsys.readouterr().out)["frames"] == 4
    frames = read_video(video)
    assert frames.shape == (4, SIZE, SIZE, 3)
    red, green, _ = frames[0, SIZE // 2, SIZE // 2].astype(int)
    assert red > green + 100
    assert run("info", scene_file, "--json") == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["anchors"], document["camera"]["width"]) == (1, SIZE)
    assert run("export", scene_file, tmp_path / "s.ply", "--steps", 0) == 0
    captured = capsys.readouterr()
    assert "1 splats" in captured.out
    assert captured.err == ""
    assert read_ply(tmp_path / "s.ply")["z"].tolist() == [1.0]


def write_cameras(path: Path, unit: str, frames: int = 6) -> Path:
    poses = make_path("dolly", frames)
    K = Camera.from_fov(SIZE, SIZE, 75).K
    document = {"name": "x", "width": SIZE, "height": SIZE, "K": K.tolist(), "world_to_camera": poses.tolist()}
    path.write_text(json.dumps({**document, "unit": unit}))
    return path


def test_camera_files(tmp_path: Path) -> None:
    camera = Camera.from_fov(SIZE, SIZE, 60)
    in_radii = str(write_cameras(tmp_path / "r.json", "R"))
    in_metres = str(write_cameras(tmp_path / "m.json", "m"))
    all_of_them = path_in_scene_radii(in_radii, None, camera, radius=4.0)
    assert len(all_of_them) == 6
    np.testing.assert_allclose(all_of_them[2].translation, make_path("dolly", 6)[2, :3, 3])
    np.testing.assert_allclose(
        path_in_scene_radii(in_metres, None, camera, radius=4.0)[2].translation, make_path("dolly", 6)[2, :3, 3] / 4
    )
    first, last = path_in_scene_radii(in_radii, 2, camera)
    np.testing.assert_array_equal(first.world_to_camera, all_of_them[0].world_to_camera)
    np.testing.assert_array_equal(last.world_to_camera, all_of_them[5].world_to_camera)


def test_field_of_view_has_an_order(tmp_path: Path) -> None:
    file = str(write_cameras(tmp_path / "r.json", "R"))
    assert choose_field_of_view(40, 50, file).degrees == 40
    assert choose_field_of_view(None, 50, file).source == "depth provider"
    from_file = choose_field_of_view(None, None, file)
    assert from_file.degrees == pytest.approx(75)
    assert from_file.source == "camera file r.json"
    assert choose_field_of_view(None, None, "spiral").degrees == 60


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    assert run(*arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    lines = [line for line in captured.err.splitlines() if not line.startswith("orca: WARNING")]
    assert len(lines) == 3, captured.err
    assert lines[1].startswith("  allowed: ")
    return captured.err


def test_bad_input_is_three_lines_and_exit_code_2(
    image: Path, scene_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, depth = tmp_path / "o", ("--depth", "constant")
    (tmp_path / "text.png").write_text("no")
    cv2.imwrite(str(tmp_path / "one.png"), np.zeros((1, 1, 3), np.uint8))
    np.save(tmp_path / "nan.npy", np.full((SIZE, SIZE), np.nan))
    np.save(tmp_path / "small.npy", np.ones((8, 8)))
    start = ("reconstruct", image, "--out")
    assert "does not exist" in refused(capsys, "reconstruct", tmp_path / "no.png", "--out", out)
    assert "not an image" in refused(capsys, "reconstruct", tmp_path / "text.png", "--out", out)
    assert "1x1" in refused(capsys, "reconstruct", tmp_path / "one.png", "--out", out)
    assert "NaN" in refused(capsys, *start, out, "--depth", f"file:{tmp_path / 'nan.npy'}")
    assert "8x8" in refused(capsys, *start, out, "--depth", f"file:{tmp_path / 'small.npy'}")
    assert "did you mean 'heuristic'" in refused(capsys, *start, out, "--depth", "heuristik")
    assert "did you mean 'spiral'" in refused(capsys, *start, out, *depth, "--trajectory", "spirl")
    assert "did you mean 'draft'" in refused(capsys, *start, out, *depth, "--preset", "daft")
    assert "is a file" in refused(capsys, *start, scene_file, *depth)
    assert "170 degrees" in refused(capsys, *start, out, *depth, "--hfov", 500)
    assert "device 'tpu'" in refused(capsys, *start, out, *depth, "--device", "tpu")
    assert "cannot be read" in refused(capsys, *start, out, *depth, "--trajectory", tmp_path / "no.json")
    assert "not a scene file" in refused(capsys, "info", image)
    assert "not a scene file" in refused(capsys, "export", tmp_path / "no.safetensors", tmp_path / "s.ply")
    video = tmp_path / "v.mp4"
    assert "1 frames" in refused(capsys, "render", scene_file, "--trajectory", "swing", "--frames", 1, "--out", video)
    assert not video.exists()


def test_debug_shows_the_traceback(tmp_path: Path) -> None:
    with pytest.raises(Exception, match="does not exist"):
        run("reconstruct", tmp_path / "no.png", "--out", tmp_path / "o", "--debug")


def test_cuda_is_refused_where_there_is_none(
    scene_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    video = tmp_path / "v.mp4"
    text = refused(capsys, "render", scene_file, "--trajectory", "swing", "--out", video, "--device", "cuda")
    assert "CUDA" in text


@pytest.mark.slow
def test_the_whole_method_runs_from_the_command_line(image: Path, tmp_path: Path) -> None:
    ramp = np.tile(np.linspace(1, 1.2, SIZE, dtype=np.float32), (SIZE, 1))
    np.save(tmp_path / "in.depth.npy", ramp)
    smooth = cv2.GaussianBlur(load_image(image), (0, 0), 3)
    save_image(image, smooth)
    assert run("reconstruct", image, "--out", tmp_path / "o", "--frames", 3, "--trajectory", "forward") == 0
    assert {p.name for p in (tmp_path / "o").iterdir()} == FILES
    scene = Scene.load(tmp_path / "o" / "scene.safetensors")
    error = scene.renderer().render(scene.camera).rgb - smooth / np.float32(255)
    assert -10 * np.log10(np.square(error).mean()) > 20
