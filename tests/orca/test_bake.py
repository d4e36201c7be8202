"""Baking: plain splats that look like the neural scene, and the verb that writes them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import skimage.data

from orca.cli import main
from orca.config import ReconstructConfig, get_preset
from orca.conventions import to_float
from orca.errors import BadInput
from orca.export import read_splats, write_splats
from orca.paths import make_path, path_cameras
from orca.pipeline import reconstruct
from orca.priors.depth import DepthEstimate
from orca.scene import Scene
from orca.splats.agreement import agreement, held_out
from orca.splats.bake import BakeConfig, anchor_splats, bake, fitted_frames
from orca.splats.gradient import footprints
from tests.orca.stage_inputs import picture, view

SIZE = 48
VIEW = view(SIZE, SIZE)
PATH = path_cameras(make_path("swing", 26), VIEW)


def without_repair() -> ReconstructConfig:
    config = get_preset("draft")
    return replace(config, repair=replace(config.repair, enabled=False))


@pytest.fixture(scope="module")
def scene() -> Scene:
    """A picture on two surfaces, a near square in front of a plane."""
    depth = np.full((SIZE, SIZE), 1.5, np.float32)
    depth[16:34, 14:30] = 0.9
    given = DepthEstimate(depth, "made up", True)
    return reconstruct(picture(SIZE, SIZE), VIEW, given, PATH[:2], without_repair()).scene


@pytest.fixture(scope="module")
def scene_file(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scene") / "scene.safetensors"
    scene.save(path)
    return path


def test_fitting_brings_the_splats_close(scene: Scene) -> None:
    """At the input view and at twice its size."""
    config = BakeConfig(steps=60)
    cameras = (scene.camera, scene.camera.resized(2 * SIZE, 2 * SIZE))
    before = agreement(scene, anchor_splats(scene), cameras)
    after = agreement(scene, bake(scene, PATH, config), cameras)
    assert after[0] > before[0] + 6
    assert after[1] > before[1] + 4


def test_a_photograph_agrees_to_35_decibels_at_the_input_view() -> None:
    """With the steps that a user gets, and depth edges: the bound that the issue asks for; views that were not fitted
    gain as well (they do on photographs, not on pictures of pixel noise).
    """
    image = cv2.resize(skimage.data.rocket()[:400, 120:520], (96, 96), interpolation=cv2.INTER_AREA)
    depth = np.full((96, 96), 1.5, np.float32)
    depth[32:66, 28:60] = 0.9
    camera = view(96, 96)
    path = path_cameras(make_path("swing", 26), camera)
    given = DepthEstimate(depth, "made up", True)
    rocket = reconstruct(to_float(image), camera, given, path[:2], without_repair()).scene
    fitted = bake(rocket, path, BakeConfig())
    tested = [path[i] for i in held_out(path, fitted_frames(len(path), BakeConfig()), camera)]
    before, after = (agreement(rocket, splats, [camera, *tested]) for splats in (anchor_splats(rocket), fitted))
    assert after[0] >= 35
    assert len(tested) == 4
    assert min(np.subtract(after, before)) > 2


def test_only_looks_change(scene: Scene) -> None:
    plain, baked = anchor_splats(scene), bake(scene, PATH, BakeConfig(steps=3, rounds=0))
    np.testing.assert_array_equal(baked.means, plain.means)
    np.testing.assert_array_equal(baked.quaternions, plain.quaternions)
    np.testing.assert_array_equal(baked.stage, scene.anchors.stage.numpy())
    growth = np.exp(baked.log_scales - plain.log_scales)
    np.testing.assert_allclose(growth, growth[:, :1].repeat(3, 1), rtol=1e-4)  # larger or smaller, not another shape
    assert growth.min() >= 0.2499
    assert growth.max() <= 1.4001
    assert baked.colours.min() >= 0
    assert baked.colours.max() <= 1


def test_splats_are_split_only_where_the_picture_asks_for_it(scene: Scene) -> None:
    few = bake(scene, PATH, BakeConfig(steps=40, target_psnr=5))
    assert len(few) == scene.num_anchors
    before = agreement(scene, few, [scene.camera])[0]
    some, most = (bake(scene, PATH, BakeConfig(steps=40, target_psnr=before + gain, rounds=1)) for gain in (0.5, 20))
    assert len(few) < len(some) < len(most) == len(few) + len(few) // 3
    after = [agreement(scene, splats, [scene.camera])[0] for splats in (some, most)]
    assert after[0] > before + 0.2
    assert after[1] > after[0] + 0.5
    again = bake(scene, PATH, BakeConfig(steps=40, target_psnr=before + 0.5))  # a second round mends what one missed
    assert agreement(scene, again, [scene.camera])[0] >= before + 0.5
    assert len(some) <= len(again) < len(most)


def test_splats_for_a_viewer_that_leaves_out_small_ones(scene: Scene) -> None:
    """None is narrower in the input view than asked for, unless it is as large as it may get."""
    baked = bake(scene, PATH, BakeConfig(steps=6, min_sigma=0.6, rounds=0))
    covariance = footprints(baked, scene.camera, 1.0).covariance.astype(float)
    narrow = np.sqrt([np.linalg.eigvalsh([[xx, xy], [xy, yy]])[0] for xx, xy, yy in covariance])
    growth = np.exp(baked.log_scales - anchor_splats(scene).log_scales)[:, 0]
    assert ((narrow >= 0.599) | (growth >= 1.399)).all()
    assert (narrow >= 0.599).mean() > 0.5


def test_baking_repeats_bit_for_bit(scene: Scene) -> None:
    one, two = (bake(scene, PATH, BakeConfig(steps=4)) for _ in range(2))
    np.testing.assert_array_equal(one.colours, two.colours)
    np.testing.assert_array_equal(one.opacities, two.opacities)


def test_no_steps_and_no_path(scene: Scene) -> None:
    np.testing.assert_array_equal(bake(scene, PATH, BakeConfig(steps=0)).colours, anchor_splats(scene).colours)
    seen: list[tuple[str, int, int]] = []
    bake(scene, (), BakeConfig(steps=2, zoom=0, rounds=1), lambda *step: seen.append(step))
    assert seen == [("bake", 1, 2), ("bake", 2, 2), ("bake, split 1", 1, 1)]
    seen.clear()
    bake(scene, (), BakeConfig(steps=1, zoom=0, rounds=1), lambda *step: seen.append(step))
    assert seen == [("bake", 1, 1), ("bake, split 1", 1, 1)]  # what was split is fitted, if only once
    for field in ("steps", "views", "rounds"):
        with pytest.raises(BadInput, match="-1"):
            BakeConfig(**{field: -1})
    with pytest.raises(BadInput, match="nan dB"):
        BakeConfig(target_psnr=float("nan"))


def test_held_out_frames_are_not_the_fitted_ones() -> None:
    fitted = fitted_frames(len(PATH), BakeConfig())
    assert len(fitted) == 6
    tested = held_out(PATH, fitted, VIEW)
    assert len(tested) == 4
    assert not set(tested) & set(fitted)
    assert fitted_frames(0, BakeConfig()) == []
    assert held_out(PATH, range(len(PATH)), VIEW) == []


def test_a_frame_at_the_place_of_a_fitted_one_is_no_test() -> None:
    """The path three times over: what the first lap fits, no other lap may test; the input view neither."""
    path = PATH * 3
    fitted = fitted_frames(len(PATH), BakeConfig())
    known = [VIEW, *(path[i] for i in fitted)]
    tested = held_out(path, fitted, VIEW, 40)
    assert len(tested) == 40
    for i in tested:
        assert min(np.abs(path[i].world_to_camera - other.world_to_camera).max() for other in known) > 1e-3
    assert held_out((VIEW,) * 5, [2], VIEW) == []


def test_the_file_holds_what_was_baked(scene: Scene, tmp_path: Path) -> None:
    baked = bake(scene, PATH, BakeConfig(steps=2))
    assert write_splats(baked, tmp_path / "s.ply") == len(baked)
    back = read_splats(tmp_path / "s.ply")
    np.testing.assert_array_equal(back.means, baked.means)
    np.testing.assert_allclose(back.colours, baked.colours, atol=1e-6)
    np.testing.assert_allclose(back.opacities, baked.opacities, atol=2e-4)
    broken = replace(baked, colours=np.full_like(baked.colours, np.nan))
    with pytest.raises(BadInput, match="not finite"):
        write_splats(broken, tmp_path / "broken.ply")


def test_a_point_cloud_is_no_splat_file(tmp_path: Path) -> None:
    head = "ply\nformat binary_little_endian 1.0\nelement vertex 1\n"
    head += "".join(f"property float {name}\n" for name in "xyz") + "end_header\n"
    (tmp_path / "points.ply").write_bytes(head.encode() + np.zeros(3, "<f4").tobytes())
    with pytest.raises(BadInput, match="without f_dc_0"):
        read_splats(tmp_path / "points.ply")


def test_export_reports_the_agreement_of_the_file(
    scene: Scene, scene_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ply = tmp_path / "s.ply"
    options = ["--steps", "5", "--trajectory", "swing", "--psnr", "--json"]
    assert main(["export", str(scene_file), str(ply), *options, "--target-psnr", "60"]) == 0
    assert json.loads(capsys.readouterr().out)["splats"] > scene.num_anchors
    assert main(["export", str(scene_file), str(ply), *options, "--target-psnr", "5"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["splats"] == scene.num_anchors
    assert answer["anchors"] == scene.num_anchors
    assert answer["bytes"] == ply.stat().st_size
    assert answer["psnr"]["input"] == pytest.approx(agreement(scene, read_splats(ply), [scene.camera])[0], abs=1e-6)
    assert 15 < answer["psnr"]["held_out"] < 60
    assert main(["export", str(scene_file), str(ply), "--steps", "-1"]) == 2
    assert "steps" in capsys.readouterr().err


def test_equal_pictures_count_as_a_hundred_decibels() -> None:
    from orca.splats.agreement import _psnr

    black = np.zeros((4, 4, 3), np.float32)
    assert _psnr(black, black) == 100
    assert _psnr(black, black + np.float32(0.1)) == pytest.approx(-20 * np.log10(26 / 255), abs=1e-6)
