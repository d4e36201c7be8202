"""Depth maps read back from colour-mapped video; the shared depth, made into such a video, comes back."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import matplotlib
import numpy as np
import pytest

from bench.cli import main
from bench.datasets.depth_video import COLOUR_MAPS, decode_values, rebuild_depth
from bench.datasets.manifest import REALMDREAMER_SCENES
from orca.errors import BadInput, Unavailable
from orca.video import write_video


def coloured(values: np.ndarray, name: str) -> np.ndarray:
    return (matplotlib.colormaps[name](values)[..., :3] * 255).astype(np.uint8)


def ramp(size: int = 64) -> np.ndarray:
    x, y = np.meshgrid(np.linspace(0, 1, size), np.linspace(0, 1, size))
    return 0.5 * x + 0.5 * y**2


@pytest.mark.parametrize("name", COLOUR_MAPS)
def test_each_colour_map_is_recognised_and_inverted(name: str) -> None:
    values, found, fit = decode_values(coloured(ramp(), name))
    assert found == name
    assert fit < 1.5
    assert np.abs(values - ramp()).max() < 0.02
    assert np.median(np.abs(values - ramp())) < 0.003


def test_a_photograph_is_refused() -> None:
    noise = np.random.default_rng(0).integers(0, 255, (64, 64, 3), np.uint8)
    with pytest.raises(BadInput, match="grey levels off every colour map"):
        decode_values(noise)


def root_with_video(root: Path, scene: str, values: np.ndarray, name: str = "plasma") -> Path:
    frame = coloured(values, name)
    write_video(root / "vistadream" / "dpt" / f"{scene}.mp4", (frame for _ in range(3)), crf=23)
    return root


def test_a_video_becomes_a_depth_map(tmp_path: Path) -> None:
    values = np.asarray(cv2.resize(ramp(), (512, 512)))
    root = root_with_video(tmp_path, "kitchen", values)
    out = root / "realmdreamer" / "depth"
    made = rebuild_depth(root, "kitchen", out)
    assert (made.written, made.colour_map, made.difference) == (True, "plasma", None)
    stored = cv2.imread(str(out / "kitchen.png"), cv2.IMREAD_UNCHANGED)
    assert stored.dtype == np.uint16
    a, b = REALMDREAMER_SCENES["kitchen"]["depth_affine"]  # type: ignore[misc]
    relative = np.abs(stored * 1e-4 - (a + b * values)) / (a + b * values)
    assert np.median(relative) < 0.007  # one grey level of 255 is 0.4 % of the range
    again = rebuild_depth(root, "kitchen", out)
    assert (again.written, again.difference, again.difference_p90) == (False, 0.0, 0.0)


def test_the_affine_map_of_scenes_json_comes_first(tmp_path: Path) -> None:
    root = root_with_video(tmp_path, "car", np.full((512, 512), 0.5), "gray")
    facts = root / "realmdreamer" / "scenes.json"
    facts.parent.mkdir()
    facts.write_text(json.dumps({"car": {"depth_affine": [1.0, 2.0]}}))
    rebuild_depth(root, "car", tmp_path / "out")
    stored = cv2.imread(str(tmp_path / "out" / "car.png"), cv2.IMREAD_UNCHANGED)
    assert np.median(stored) == pytest.approx(20000, rel=0.01)
    for broken, said in (('{"car": {"depth_affine": [1]}}', "no depth_affine"), ("[", "scenes.json is not JSON")):
        facts.write_text(broken)
        with pytest.raises(BadInput, match=said):
            rebuild_depth(root, "car", tmp_path / "out2")


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root = root_with_video(tmp_path, "bear", np.full((512, 512), 0.5))
    assert main(["depth", "--data-root", str(root), "--scenes", "bear,car", "--json"]) == 1
    scenes = json.loads(capsys.readouterr().out)["scenes"]
    assert scenes[0]["written"] is True
    assert "bench download" in scenes[1]["problem"]
    with pytest.raises(Unavailable, match=r"visual/dpt/car\.mp4"):
        rebuild_depth(root, "car", tmp_path)


def test_the_shared_depth_of_one_scene_comes_back(data_root: Path, tmp_path: Path) -> None:
    """Kitchen's depth, coloured and written as VistaDream does (the published depth video is not in the data root)."""
    scene = "kitchen"
    truth = cv2.imread(str(data_root / "realmdreamer" / "depth" / f"{scene}.png"), cv2.IMREAD_UNCHANGED) * 1e-4
    a, b = REALMDREAMER_SCENES[scene]["depth_affine"]  # type: ignore[misc]
    root = root_with_video(tmp_path, scene, np.clip((truth - a) / b, 0, 1))
    rebuild_depth(root, scene, tmp_path)
    back = cv2.imread(str(tmp_path / f"{scene}.png"), cv2.IMREAD_UNCHANGED) * 1e-4
    relative = np.abs(back - truth) / truth
    assert np.median(relative) < 0.007
    assert np.percentile(relative, 90) < 0.03
