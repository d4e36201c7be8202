"""The whole method: determinism, placement, records, bad input."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from orca.camera import Camera
from orca.config import get_preset
from orca.errors import BadInput
from orca.pipeline import reconstruct
from orca.priors.depth import DepthEstimate
from orca.scene import Scene
from tests.orca.repair_scenes import SIZE, estimate, input_camera, picture, sideways, small_config


def test_one_seed_gives_one_scene_file(tmp_path: Path) -> None:
    image, depth = picture()
    for name in ("a", "b"):
        result = reconstruct(image, input_camera(), estimate(depth), sideways(0.12), small_config(), seed=3)
        result.scene.save(tmp_path / name)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_the_saved_scene_renders_the_same(tmp_path: Path) -> None:
    image, depth = picture()
    result = reconstruct(image, input_camera(), estimate(depth), sideways(0.12), small_config())
    result.scene.save(tmp_path / "scene.safetensors")
    again = Scene.load(tmp_path / "scene.safetensors")
    view = sideways(0.12)[1]
    assert np.array_equal(again.renderer().render(view).rgb, result.scene.renderer().render(view).rgb)


def test_record_and_ledger_are_json() -> None:
    image, depth = picture()
    result = reconstruct(image, input_camera(), estimate(depth), sideways(0.12), small_config())
    record = json.loads(json.dumps(result.record))
    assert set(record["seconds"]) == {"canvas", "planar", "deform", "repair"}
    assert record["input_psnr"]["planar"] > 40  # an anchor per pixel interpolates
    # The rim of the square is 2 % of so small a picture, and near and far anchors cannot share its pixels.
    assert record["input_psnr"]["final"] > 20
    assert sum(record["anchors"].values()) == result.scene.num_anchors
    assert json.loads(json.dumps(result.ledger))["schema_version"] == 1


def test_relative_lifting_is_placed_by_the_median_ratio() -> None:
    image, depth = picture()
    tilted = (depth + np.linspace(0, 1, SIZE, dtype=np.float32)[:, None]) * 7
    config = replace(small_config(), repair=replace(small_config().repair, enabled=False)).with_lifting("relative")
    scene_depth = reconstruct(image, input_camera(), estimate(tilted), [input_camera()], config)
    z = scene_depth.scene.anchors.means[:, 2].numpy()
    pixels, _ = input_camera().project(scene_depth.scene.anchors.means.double().numpy())
    column, row = np.clip(pixels.astype(int), 0, SIZE - 1).T
    assert np.median(z / tilted[row, column]) == pytest.approx(1, rel=0.02)
    assert scene_depth.record["placement"]["spread"] > 1.01


def test_paper_preset_trains_by_gradient() -> None:
    image, depth = picture()
    paper = get_preset("paper")
    config = replace(
        paper,
        planar=replace(paper.planar, max_iterations=80, anchors_per_pixel=0.25),
        deform=replace(paper.deform, max_iterations=20),
        train=replace(paper.train, batch_rays=512, eval_every=20),
        repair=replace(paper.repair, rules=replace(paper.repair.rules, max_iterations=2)),
        canvas=replace(paper.canvas, max_scale=1.2),
    )
    result = reconstruct(image, input_camera(), estimate(depth), sideways(0.1, 2), config)
    history = result.record["history"]
    assert history["planar fit"]["iterations"] == 80
    assert history["fine-tuning"]["iterations"] == 20
    flat = -10 * np.log10(np.square(image - image.mean((0, 1))).mean())
    assert result.record["input_psnr"]["planar"] > flat + 1


def test_canvas_reaches_as_far_as_the_trajectory_looks() -> None:
    image, depth = picture()
    off = replace(small_config(), repair=replace(small_config().repair, enabled=False))
    near = reconstruct(image, input_camera(), estimate(depth), [input_camera()], off)
    far = reconstruct(image, input_camera(), estimate(depth), sideways(0.12), off)
    assert near.record["margins"] == [0, 0, 0, 0]
    assert far.record["margins"][2] > 0


@pytest.mark.parametrize(
    ("image", "depth", "camera", "views"),
    [
        (np.zeros((SIZE, SIZE), np.float32), np.ones((SIZE, SIZE)), input_camera(), 1),
        (np.zeros((SIZE, SIZE, 3), np.float32), np.ones((SIZE, SIZE - 1)), input_camera(), 1),
        (np.zeros((8, 8, 3), np.float32), np.ones((8, 8)), Camera.from_fov(8, 8, 60), 1),
        (np.zeros((SIZE, SIZE, 3), np.float32), np.ones((SIZE, SIZE)), sideways(0.1)[1], 1),
        (np.zeros((SIZE, SIZE, 3), np.float32), np.ones((SIZE, SIZE)), input_camera(), 0),
    ],
)
def test_what_does_not_fit_together_is_refused(
    image: np.ndarray, depth: np.ndarray, camera: Camera, views: int
) -> None:
    given = DepthEstimate(depth.astype(np.float32), "test", True)
    with pytest.raises(BadInput):
        reconstruct(image, camera, given, [input_camera()] * views, small_config())
