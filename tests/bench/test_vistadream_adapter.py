"""Published videos as a method: only along the cameras that they were rendered from."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from bench.adapters import METHODS, RunOptions
from bench.adapters.vistadream import VISTADREAM, VISTADREAM_COARSE
from bench.datasets import SceneCase, open_dataset
from bench.trajectories import build_trajectory
from orca.errors import BadInput, Unavailable
from orca.video import write_video


def number_of(frame: np.ndarray) -> int:
    """Fake frames carry their number as two grey levels: tens in the left half, ones in the right."""
    half = frame.shape[1] // 2
    tens, ones = frame[:, : half - 4].mean(), frame[:, half + 4 :].mean()
    return 10 * round((float(tens) - 20) / 8) + round((float(ones) - 20) / 8)


def numbered(i: int, size: int) -> np.ndarray:
    frame = np.full((size, size, 3), 20 + 8 * (i // 10), np.uint8)
    frame[:, size // 2 :] = 20 + 8 * (i % 10)
    return frame


@pytest.fixture(scope="module")
def fake_root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data root with one scene of 64x64 pixels and a refined video of 48x48."""
    root = tmp_path_factory.mktemp("root")
    base = root / "realmdreamer"
    (base / "images").mkdir(parents=True)
    (base / "depth").mkdir()
    entry = {"fx_512": 443.4, "forward_ratio": 0.3, "backward_ratio": 0.8}
    (base / "scenes.json").write_text(json.dumps({"car": entry, "bear": entry}))
    for scene in ("car", "bear"):
        cv2.imwrite(str(base / "images" / f"{scene}.png"), np.full((64, 64, 3), 99, np.uint8))
        cv2.imwrite(str(base / "depth" / f"{scene}.png"), np.full((64, 64), 9999, np.uint16))
    write_video(root / "vistadream" / "rgb" / "car.mp4", (numbered(i, 48) for i in range(250)))
    return root


def load(root: Path, scene: str = "car", trajectory: str | None = None) -> SceneCase:
    return open_dataset("realmdreamer", data_root=root, trajectory=trajectory).load(scene)


def test_the_registry_knows_both() -> None:
    assert METHODS.get("vistadream") is VISTADREAM
    assert METHODS.get("vistadream-coarse") is VISTADREAM_COARSE
    assert VISTADREAM.version(RunOptions()) != VISTADREAM_COARSE.version(RunOptions())
    assert VISTADREAM.version(RunOptions(preset="paper", seed=3)) == VISTADREAM.version(RunOptions())


def test_frames_are_those_of_the_evaluated_indices(fake_root: Path) -> None:
    case = load(fake_root)
    seen: list[tuple[str, int, int]] = []
    options = RunOptions(data_root=fake_root, progress=lambda phase, done, total: seen.append((phase, done, total)))
    output = VISTADREAM.run(case, options)
    assert output.frames.shape == (50, 48, 48, 3)
    assert [number_of(frame) for frame in output.frames] == list(case.eval_indices)
    assert output.input_view is not None
    assert number_of(output.input_view) == 0
    assert (output.true_views, output.coverage, output.timing) == (None, None, {})
    assert output.notes[0] == "decoded from H.264 crf 23, published, not timed here"
    assert "48x48" in output.notes[1]
    assert seen[-1] == ("decode", 1, 1)


def test_a_subset_of_the_frames(fake_root: Path) -> None:
    case = dataclasses.replace(load(fake_root), eval_indices=(200, 3))
    output = VISTADREAM.run(case, RunOptions(data_root=fake_root))
    assert [number_of(frame) for frame in output.frames] == [200, 3]


def test_missing_video(fake_root: Path) -> None:
    options = RunOptions(data_root=fake_root)
    with pytest.raises(Unavailable, match=r"bear\.mp4"):
        VISTADREAM.run(load(fake_root, "bear"), options)
    with pytest.raises(Unavailable, match="coarse"):
        VISTADREAM_COARSE.run(load(fake_root), options)


def test_another_dataset(fake_root: Path) -> None:
    case = dataclasses.replace(load(fake_root), dataset="photos")
    with pytest.raises(BadInput, match="data set 'photos'"):
        VISTADREAM.run(case, RunOptions(data_root=fake_root))


def test_another_trajectory(fake_root: Path) -> None:
    options = RunOptions(data_root=fake_root)
    with pytest.raises(BadInput, match=r"'swing' of 99 frames differs .* at frame 1"):
        VISTADREAM.run(load(fake_root, trajectory="swing"), options)
    case = load(fake_root)
    short = dataclasses.replace(case, trajectory=build_trajectory("vistadream", case.camera, 100))
    with pytest.raises(BadInput, match="of 100 frames"):
        VISTADREAM.run(short, options)
    poses = case.trajectory.world_to_camera.copy()
    poses[77, 0, 3] += 0.01
    bent = dataclasses.replace(case, trajectory=dataclasses.replace(case.trajectory, world_to_camera=poses))
    with pytest.raises(BadInput, match="at frame 77"):
        VISTADREAM.run(bent, options)


def test_broken_videos(fake_root: Path, tmp_path: Path) -> None:
    root = tmp_path / "root"
    shutil.copytree(fake_root, root)
    video = root / "vistadream" / "rgb" / "car.mp4"
    write_video(video, (numbered(i, 48) for i in range(30)))
    with pytest.raises(BadInput, match="has 30 frames"):
        VISTADREAM.run(load(root), RunOptions(data_root=root))
    video.write_text("no video")
    with pytest.raises(BadInput, match="unreadable video"):
        VISTADREAM.run(load(root), RunOptions(data_root=root))


def test_published_videos(data_root: Path) -> None:
    """The video's first frame is the input view: it looks like the input image, also at the native size of bust."""
    options = RunOptions(data_root=data_root)
    for adapter, scene, size in ((VISTADREAM, "bust", 480), (VISTADREAM_COARSE, "kitchen", 512)):
        case = load(data_root, scene)
        output = adapter.run(dataclasses.replace(case, eval_indices=(0, 60)), options)
        assert output.frames.shape == (2, size, size, 3)
        assert len(output.notes) == (2 if size == 480 else 1)
        image = cv2.resize(case.image, (size, size), interpolation=cv2.INTER_AREA).astype(float)
        error = [float(np.mean((frame - image) ** 2)) for frame in output.frames]
        assert 10 * np.log10(255**2 / error[0]) > 18
        assert error[0] < 0.5 * error[1]
