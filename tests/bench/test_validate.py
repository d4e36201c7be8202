"""`bench validate` and `bench cameras`: what a user asks before an hour of measuring."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from bench.cli import main
from bench.validation import detected, scene_names
from orca.errors import BadInput
from orca.images import save_image
from orca.video import write_video
from tests.bench.splat_files import cloud_of, save_vistadream_scene, write_ply


@pytest.fixture
def images(tmp_path: Path) -> Path:
    """A data set of two images of one size, with a depth map each."""
    folder = tmp_path / "images"
    for name in ("one", "two"):
        save_image(folder / f"{name}.png", np.full((24, 32, 3), 99, np.uint8))
        np.save(folder / f"{name}.depth.npy", np.full((24, 32), 2.0, np.float32))
    return folder


def answer(capsys: pytest.CaptureFixture[str], *argv: object) -> tuple[int, dict[str, object]]:
    code = main([*map(str, argv), "--json"])
    return code, json.loads(capsys.readouterr().out)


@pytest.fixture
def frames(images: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    """Frames along the cameras that `bench cameras` wrote."""
    out = tmp_path / "theirs"
    code, document = answer(capsys, "cameras", "--dataset", "folder", "--images", images, "--out", out)
    assert code == 0
    scenes = document["scenes"]
    assert isinstance(scenes, list)
    assert [s["cameras"] for s in scenes] == [99, 99]
    assert (out / "one.png").is_file()
    for name in ("one", "two"):
        for i in range(99):
            save_image(out / name / f"{i}.png", np.full((24, 32, 3), i, np.uint8))
    return out


def test_good_frames(frames: Path, images: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, alone = answer(capsys, "validate", frames)
    assert (code, alone["kind"], alone["usable"]) == (0, "frames", True)
    scene = alone["scenes"][0]  # type: ignore[index]
    assert (scene["frames"], scene["size"], scene["first"], scene["last"]) == (99, [32, 24], "0.png", "98.png")
    assert (scene["cameras"], len(scene["cameras_sha256"])) == (99, 64)
    code, against = answer(capsys, "validate", f"mine=frames:{frames}", "--dataset", "folder", "--images", images)
    assert (code, against["usable"]) == (0, True)
    assert main(["validate", str(frames)]) == 0
    text = capsys.readouterr().out
    assert "one: 99 frames of 32x24, 0.png to 98.png, 99 cameras" in text
    assert "2 of 2 scenes usable as frames; cameras not compared" in text


def test_the_first_problem_of_each_scene(frames: Path, images: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (frames / "one" / "7.png").write_bytes(b"broken")
    code, document = answer(capsys, "validate", frames)
    one, two = document["scenes"]  # type: ignore[misc]
    assert (code, two["problem"]) == (1, None)
    assert "7.png' is not an image" in one["problem"]
    assert (one["frames"], one["cameras"]) == (99, 99)  # what was found before it stays said
    (frames / "one" / "7.png").unlink()
    _, document = answer(capsys, "validate", frames, "--scenes", "one")
    assert "98 images and 99 cameras" in document["scenes"][0]["problem"]  # type: ignore[index]
    camera_file = frames / "two" / "cameras.json"
    cameras = json.loads(camera_file.read_text())
    cameras["world_to_camera"][3][0][3] += 0.1
    camera_file.write_text(json.dumps(cameras))
    code, _ = answer(capsys, "validate", frames, "--scenes", "two")
    assert code == 0
    code, document = answer(capsys, "validate", frames, "--scenes", "two", "--dataset", "folder", "--images", images)
    assert code == 1
    assert "the pose of frame 3" in document["scenes"][0]["problem"]  # type: ignore[index]


def test_missing_scenes_of_the_data_set(frames: Path, images: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.rmtree(frames / "two")
    code, document = answer(capsys, "validate", frames, "--dataset", "folder", "--images", images)
    assert code == 1
    assert "no folder" in document["scenes"][1]["problem"]  # type: ignore[index]


def test_every_kind_is_recognised(frames: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_ply(tmp_path / "p" / "wall.ply", cloud_of(9))
    save_vistadream_scene(tmp_path / "v" / "wall" / "scene.pth", cloud_of(8))
    write_video(tmp_path / "r" / "wall" / "refine.video_rgb.mp4", (np.zeros((32, 32, 3), np.uint8) for _ in range(5)))
    write_video(tmp_path / "m" / "one.mp4", (np.zeros((24, 32, 3), np.uint8) for _ in range(99)))
    shutil.copy(frames / "one" / "cameras.json", tmp_path / "m" / "one.json")
    for folder, kind, fact in (
        ("p", "ply", ("splats", 9)),
        ("v", "vistadream-scene", ("splats", 8)),
        ("r", "vistadream-video", ("frames", 5)),
        ("m", "video", ("frames", 99)),
    ):
        code, document = answer(capsys, "validate", tmp_path / folder)
        assert (code, document["kind"]) == (0, kind)
        assert document["scenes"][0][fact[0]] == fact[1]  # type: ignore[index]
    write_video(tmp_path / "m" / "one.mp4", (np.zeros((24, 32, 3), np.uint8) for _ in range(98)))
    code, document = answer(capsys, "validate", tmp_path / "m")
    assert "98 frames and 99 cameras" in document["scenes"][0]["problem"]  # type: ignore[index]


def test_a_damaged_video_is_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its packets can be counted; its pictures cannot be decoded."""
    noise = np.random.default_rng(0).integers(0, 255, (20, 64, 64, 3), np.uint8)
    file = tmp_path / "r" / "wall" / "video_rgb.mp4"
    write_video(file, noise)
    content = bytearray(file.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 20_000] = b"\0" * len(content[middle : middle + 20_000])
    file.write_bytes(bytes(content))
    code, document = answer(capsys, "validate", tmp_path / "r")
    assert (code, document["scenes"][0]["frames"]) == (1, 20)  # type: ignore[index]
    assert "unreadable video" in document["scenes"][0]["problem"]  # type: ignore[index]


def test_an_orca_scene(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "s").mkdir()
    (tmp_path / "s" / "one.safetensors").write_bytes(b"not one")
    code, document = answer(capsys, "validate", tmp_path / "s")
    assert (code, document["kind"]) == (1, "orca-scene")
    assert "is not a scene file" in document["scenes"][0]["problem"]  # type: ignore[index]


def test_no_such_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["validate", str(tmp_path / "none")]) == 2
    assert "no folder" in capsys.readouterr().err
    (tmp_path / "empty").mkdir()
    assert main(["validate", str(tmp_path / "empty")]) == 2
    assert "holds no scene" in capsys.readouterr().err
    assert main(["validate", f"frames:{tmp_path / 'empty'}"]) == 2
    assert "no scene in" in capsys.readouterr().err
    with pytest.raises(BadInput, match="holds no scene"):
        detected(str(tmp_path / "empty"))


def test_names_of_scenes(tmp_path: Path) -> None:
    for name in ("s10", "s9", ".hidden"):
        (tmp_path / name).mkdir()
    (tmp_path / "s2.mp4").touch()
    assert scene_names(detected(f"video:{tmp_path}")) == ("s2", "s9", "s10")
    assert scene_names(detected(f"frames:{tmp_path}")) == ("s9", "s10")


def test_published_videos(data_root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, document = answer(capsys, "validate", data_root / "vistadream", "--scenes", "bust,car")
    assert (code, document["kind"]) == (0, "vistadream-video")
    assert [s["size"] for s in document["scenes"]] == [[480, 480], [512, 512]]  # type: ignore[attr-defined]
