"""`--target-psnr`, `--max-anchors` and `--price` from the command line to the files: what was asked for is there."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from orca.conventions import to_float
from orca.images import load_image, save_image
from orca.scene import Scene

SIZE = 48
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A photograph's kind of picture: texture on the left, nothing on the right; its depth lies beside it."""
    folder = tmp_path_factory.mktemp("image")
    noise = np.random.default_rng(0).integers(0, 256, (SIZE, SIZE, 3)).astype(np.float32)
    picture = cv2.GaussianBlur(noise, (0, 0), 1.5)
    picture[:, SIZE // 2 :] = 140
    save_image(folder / "in.png", picture.astype(np.uint8))
    np.save(folder / "in.depth.npy", np.tile(np.linspace(1, 1.3, SIZE, dtype=np.float32), (SIZE, 1)))
    return folder / "in.png"


def reconstructed(image: Path, out: Path, *options: object) -> dict[str, Any]:
    """The document that ``python -m orca reconstruct`` printed."""
    command = [sys.executable, "-m", "orca", "reconstruct", image, "--out", out, "--frames", 2, "--json", *options]
    command += ["--trajectory", "swing", "--preset", "quality"]
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    document: dict[str, Any] = json.loads(done.stdout)
    return document


def input_psnr(image: Path, out: Path) -> float:
    """Measured from the files that were written, in dB."""
    scene = Scene.load(out / "scene.safetensors")
    error = np.clip(scene.renderer().render(scene.camera).rgb, 0, 1) - to_float(load_image(image))
    return float(-10 * np.log10(np.square(error).mean()))


def test_the_target_is_reached_and_not_by_an_anchor_a_pixel(image: Path, tmp_path: Path) -> None:
    document = reconstructed(image, tmp_path, "--target-psnr", 45)
    assert document["stopped"]["growth"] == "reached 45 dB"
    assert document["input_psnr"]["final"] >= 45
    assert input_psnr(image, tmp_path) == pytest.approx(document["input_psnr"]["final"], abs=0.02)
    assert document["anchors_by_stage"]["original"] < 0.4 * SIZE * SIZE
    assert document["canvas"]["limit"] == 2.5
    assert 1 <= max(document["canvas"]["scale"]) <= 2.5
    assert document["stopped"]["repair"]
    assert list(document["stopped"]["training"]) == ["all"]


def test_no_more_anchors_than_allowed(image: Path, tmp_path: Path) -> None:
    document = reconstructed(image, tmp_path, "--max-anchors", 700)
    assert document["stopped"]["growth"] == "reached 700 anchors"
    stages = document["anchors_by_stage"]
    assert 600 < stages["original"] + stages["outpainted"] <= 700
    assert Scene.load(tmp_path / "scene.safetensors").num_anchors == document["anchors"] == sum(stages.values())


def test_a_higher_price_buys_fewer_anchors_and_is_named(image: Path, tmp_path: Path) -> None:
    counts = []
    for price in (10, 60):
        document = reconstructed(image, tmp_path / str(price), "--price", price)
        assert document["stopped"]["growth"].startswith("a thousand anchors gained ")
        assert document["stopped"]["growth"].endswith(f"less than their price of {price}")
        counts.append(document["anchors"])
    assert counts[1] < counts[0]
    settings = json.loads((tmp_path / "60" / "config.json").read_text())
    assert settings["growth"]["price"] == 60
    assert settings["run"]["growth"]["stopped"].endswith("price of 60")
