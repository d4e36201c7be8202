"""Frames from elsewhere: as images, as videos, as VistaDream writes them; and how such methods are named."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from bench.adapters import METHODS, RunOptions, open_methods
from bench.adapters.external import KIND_DESCRIPTIONS, KINDS, parse_external
from bench.adapters.sources import fingerprint
from bench.adapters.video_facts import video_facts
from bench.adapters.vistadream import unstretched
from bench.runner import RunRequest, run_bench
from bench.trajectories import Trajectory, save_trajectory
from orca.errors import BadInput, Unavailable, Unknown
from orca.images import save_image
from orca.video import write_video
from tests.bench import spine_fakes as fakes
from tests.bench.splat_files import flat_case


def numbered(i: int, size: tuple[int, int] = (40, 32)) -> np.ndarray:
    return np.full((size[1], size[0], 3), 2 * i + 20, np.uint8)


def number_of(frame: np.ndarray) -> int:
    return round((float(frame.mean()) - 20) / 2)


def write_frames(folder: Path, trajectory: Trajectory, count: int | None = None) -> None:
    folder.mkdir(parents=True)
    save_trajectory(trajectory, folder / "cameras.json")
    for i in range(len(trajectory) if count is None else count):
        save_image(folder / f"f{i}.png", numbered(i))


def test_names_of_external_methods() -> None:
    spec = parse_external("theirs=ply:/data/a b?x=1")
    assert (spec.name, spec.kind, spec.path, spec.options) == ("theirs", "ply", Path("/data/a b"), {"x": "1"})
    assert parse_external("frames:/data/lucid dreamer/").name == "frames-lucid-dreamer"
    assert parse_external("frames:/").name == "frames-root"
    assert parse_external("video:/d/x=y:z").path == Path("/d/x=y:z")
    with pytest.raises(Unknown, match=r"(?s)'frame'.*did you mean 'frames'"):
        parse_external("frame:/x")
    for text, said in (
        ("frames:", "without a file"),
        ("a/b=frames:/x", "the name 'a/b'"),
        ("=frames:/x", "the name ''"),
    ):
        with pytest.raises(BadInput, match=said):
            parse_external(text)
    assert set(KIND_DESCRIPTIONS) == set(KINDS)


def test_the_registry_opens_external_methods(tmp_path: Path) -> None:
    for kind in KINDS:
        adapter = METHODS.get(f"mine={kind}:{tmp_path}")
        assert adapter.name == "mine"
        assert str(tmp_path) in adapter.version(RunOptions())
    with pytest.raises(BadInput, match="no folder"):
        METHODS.get(f"frames:{tmp_path}/none")
    with pytest.raises(BadInput, match="no built-in method"):
        METHODS.get(f"orca=frames:{tmp_path}")
    with pytest.raises(Unknown, match="option 'speed'"):
        METHODS.get(f"frames:{tmp_path}?speed=2")
    with pytest.raises(BadInput, match="stage=fine"):
        METHODS.get(f"vistadream-scene:{tmp_path}?stage=fine")
    with pytest.raises(BadInput, match="two methods named"):
        open_methods(("warp", f"a=frames:{tmp_path}", f"a=video:{tmp_path}"), METHODS)
    assert list(open_methods(("warp", f"a=frames:{tmp_path}"), METHODS)) == ["warp", "a"]


def test_fingerprint_sees_a_new_file_and_a_changed_one(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    file = tmp_path / "a" / "x.png"
    file.write_bytes(b"1")
    first = fingerprint(tmp_path)
    assert fingerprint(tmp_path) == first
    file.write_bytes(b"22")
    second = fingerprint(tmp_path)
    (tmp_path / "y.png").touch()
    assert len({first, second, fingerprint(tmp_path)}) == 3


def test_frames_of_the_whole_path_and_of_the_evaluated_part(tmp_path: Path) -> None:
    case = flat_case()
    write_frames(tmp_path / "all" / "wall", case.trajectory)
    write_frames(tmp_path / "some" / "wall", case.eval_trajectory)
    whole = METHODS.get(f"frames:{tmp_path / 'all'}").run(case, RunOptions())
    part = METHODS.get(f"frames:{tmp_path / 'some'}").run(case, RunOptions())
    assert [number_of(f) for f in whole.frames] == [0, 10, 20, 98]
    assert [number_of(f) for f in part.frames] == [0, 1, 2, 3]
    assert whole.input_view is not None
    assert number_of(whole.input_view) == 0
    assert whole.notes == ("read from image files, not timed here",)
    assert whole.coverage is None


def test_names_in_the_camera_file_decide(tmp_path: Path) -> None:
    """A transforms.json that lists the frames in another order than their names have."""
    case = flat_case()
    folder = tmp_path / "wall"
    write_frames(folder, case.trajectory)
    (folder / "cameras.json").unlink()
    flip = np.diag([1.0, -1, -1, 1])
    entries = [
        {"file_path": f"f{i}.png", "transform_matrix": (np.linalg.inv(pose) @ flip).tolist()}
        for i, pose in enumerate(case.trajectory.world_to_camera)
    ]
    K = case.camera.K
    lens = {"fl_x": K[0, 0], "fl_y": K[1, 1], "cx": K[0, 2], "cy": K[1, 2], "w": 40, "h": 32}
    (folder / "transforms.json").write_text(json.dumps({**lens, "frames": entries[::-1]}))
    output = METHODS.get(f"frames:{tmp_path}").run(case, RunOptions())
    assert [number_of(f) for f in output.frames] == [0, 10, 20, 98]
    (folder / "f98.png").rename(folder / "g98.png")
    with pytest.raises(BadInput, match=r"no image f98\.png \(1 of 99 missing\)"):
        METHODS.get(f"frames:{tmp_path}").run(case, RunOptions())


def test_broken_frame_folders(tmp_path: Path) -> None:
    case = flat_case()
    method = METHODS.get(f"frames:{tmp_path}")
    with pytest.raises(Unavailable, match="no folder"):
        method.run(case, RunOptions())
    folder = tmp_path / "wall"
    folder.mkdir()
    with pytest.raises(Unavailable, match="0 images"):
        method.run(case, RunOptions())
    save_image(folder / "f0.png", numbered(0))
    with pytest.raises(Unavailable, match="no camera file"):
        method.run(case, RunOptions())
    shutil.rmtree(folder)
    write_frames(folder, case.trajectory, 98)
    with pytest.raises(BadInput, match="98 images and 99 cameras"):
        method.run(case, RunOptions())
    save_image(folder / "f98.png", numbered(98, (41, 32)))
    with pytest.raises(BadInput, match=r"f98\.png is 41x32"):
        method.run(case, RunOptions())
    (folder / "f98.png").write_bytes(b"no image")
    with pytest.raises(BadInput, match="not an image"):
        method.run(case, RunOptions())


def test_videos_with_cameras(tmp_path: Path) -> None:
    case = flat_case()
    write_video(tmp_path / "wall.mp4", (numbered(i) for i in range(99)), crf=1)
    method = METHODS.get(f"video:{tmp_path}")
    with pytest.raises(Unavailable, match="no camera file"):
        method.run(case, RunOptions())
    save_trajectory(case.trajectory, tmp_path / "wall.json")
    output = method.run(case, RunOptions())
    assert [number_of(f) for f in output.frames] == [0, 10, 20, 98]
    assert video_facts(tmp_path / "wall.mp4") == video_facts(tmp_path / "wall.mp4").__class__(99, 40, 32)
    folder = tmp_path / "b" / "wall"
    folder.mkdir(parents=True)
    write_video(folder / "render.mp4", (numbered(i, (80, 64)) for i in range(99)), crf=1)
    save_trajectory(case.trajectory, folder / "cameras.json")
    large = METHODS.get(f"video:{tmp_path / 'b'}").run(case, RunOptions())
    assert large.frames.shape == (4, 64, 80, 3)
    assert "given at 80x64" in large.notes[1]
    write_video(tmp_path / "wall.mp4", (numbered(i) for i in range(98)))
    with pytest.raises(BadInput, match="98 frames and 99 cameras"):
        method.run(case, RunOptions())
    (tmp_path / "wall.mp4").write_bytes(b"no video")
    with pytest.raises(BadInput, match="unreadable video"):
        method.run(case, RunOptions())


def along_vistadream(width: int, height: int) -> object:
    case = flat_case(width, height)
    path = dataclasses.replace(case.trajectory, name="vistadream")
    return dataclasses.replace(case, trajectory=path)


@pytest.mark.parametrize("name", ["wall/refine.video_rgb.mp4", "wall/video_rgb.mp4", "rgb/wall.mp4", "wall.mp4"])
def test_vistadream_runs_by_all_their_names(tmp_path: Path, name: str) -> None:
    case = along_vistadream(48, 32)
    write_video(tmp_path / name, (numbered(i, (48, 32)) for i in range(99)), crf=1)
    write_video(tmp_path / "wall" / "coarse.video_rgb.mp4", (numbered(98 - i, (48, 32)) for i in range(99)), crf=1)
    output = METHODS.get(f"vistadream-video:{tmp_path}").run(case, RunOptions())
    assert [number_of(f) for f in output.frames] == [0, 10, 20, 98]
    coarse = METHODS.get(f"vistadream-video:{tmp_path}?stage=coarse").run(case, RunOptions())
    assert [number_of(f) for f in coarse.frames] == [98, 88, 78, 0]


def test_vistadream_run_refused(tmp_path: Path) -> None:
    method = METHODS.get(f"vistadream-video:{tmp_path}")
    with pytest.raises(BadInput, match="along trajectory 'swing'"):
        method.run(flat_case(48, 32), RunOptions())
    case = along_vistadream(48, 32)
    with pytest.raises(Unavailable, match="refine video"):
        method.run(case, RunOptions())
    write_video(tmp_path / "wall.mp4", (numbered(i, (48, 32)) for i in range(98)))
    with pytest.raises(BadInput, match="has 98 frames"):
        method.run(case, RunOptions())


def test_the_macro_block_stretch_is_undone(tmp_path: Path) -> None:
    """70x50 comes back as 80x64 from the writer; undone, a frame looks as it did before."""
    case = along_vistadream(70, 50)
    rng = np.random.default_rng(0)
    picture = cv2.GaussianBlur(rng.integers(0, 255, (50, 70, 3), np.uint8).astype(np.float32), (0, 0), 4)
    picture = np.clip((picture - 127) * 8 + 127, 0, 255).astype(np.uint8)
    stretched = cv2.resize(picture, (80, 64), interpolation=cv2.INTER_CUBIC)
    write_video(tmp_path / "wall.mp4", (stretched for _ in range(99)), crf=5)
    output = METHODS.get(f"vistadream-video:{tmp_path}").run(case, RunOptions())
    assert output.frames.shape == (4, 50, 70, 3)
    assert cv2.PSNR(output.frames[0], picture) > 32
    assert "undone" in output.notes[1]


def test_sizes_of_vistadream_frames() -> None:
    def given(width: int, height: int) -> np.ndarray:
        return np.zeros((1, height, width, 3), np.uint8)

    # An image of 1000x700 is rendered at int(731.4) x 512 and written at 736x512.
    assert unstretched(given(736, 512), 1000, 700, "v").shape == (1, 512, 731, 3)
    assert unstretched(given(731, 512), 1000, 700, "v").shape == (1, 512, 731, 3)
    assert unstretched(given(480, 480), 512, 512, "v").shape == (1, 480, 480, 3)  # bust, as published
    with pytest.raises(BadInput, match=r"(?s)736x528 .*731x512"):
        unstretched(given(736, 528), 1000, 700, "v")


def test_a_run_with_an_external_method(tmp_path: Path) -> None:
    """The row has its name; a rerun computes nothing; changed frames are scored again; a bad scene fails alone."""
    dataset = fakes.FakeDataset(names=("a", "b"))
    for scene in "ab":
        case = dataset.load(scene)
        folder = tmp_path / "theirs" / scene
        folder.mkdir(parents=True)
        poses = case.trajectory.world_to_camera
        if scene == "b":
            poses = np.array(poses)
            poses[4, 0, 3] = 9
        K = case.camera.resized(32, 24).K
        views = dataclasses.replace(case.trajectory, K=K, width=32, height=24, world_to_camera=poses)
        save_trajectory(views, folder / "cameras.json")
        for i in range(5):
            save_image(folder / f"{i}.png", np.full((24, 32, 3), 50 + i, np.uint8))
    request = RunRequest(dataset, ("a", "b"), (f"theirs=frames:{tmp_path / 'theirs'}",), ("bright",), tmp_path / "run")
    summary = run_bench(request, methods=METHODS, metrics=fakes.METRICS)
    assert summary.failed == (("theirs", "b"),)
    record = json.loads((tmp_path / "run" / "scenes" / "theirs" / "b.json").read_text())
    assert "frame 4" in json.dumps(record["failure"])
    assert run_bench(request, methods=METHODS, metrics=fakes.METRICS).computed == 0
    save_image(tmp_path / "theirs" / "a" / "2.png", np.full((24, 32, 3), 90, np.uint8))
    assert run_bench(request, methods=METHODS, metrics=fakes.METRICS).computed == 2
    document = json.loads((tmp_path / "run" / "run.json").read_text())
    assert document["methods"] == ["theirs"]
