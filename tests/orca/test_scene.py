"""Scene files: exact, reproducible, and refused when they are something else."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file

from orca.anchors import GaussianAnchors
from orca.config import RenderConfig
from orca.errors import BadInput
from orca.field.decoders import analytic_decoders
from orca.scene import SCHEMA_VERSION, Scene
from tests.orca.anchor_scenes import random_anchors, random_camera, random_decoders


@pytest.fixture
def scene() -> Scene:
    camera = random_camera(0, 33, 21)
    anchors = random_anchors(0, 80, camera)
    anchors = replace(anchors, stage=torch.arange(80, dtype=torch.uint8) % 3)
    config = RenderConfig(decode="per_hit", window=2, chi2=11.3449, background=0.125)
    return Scene(anchors, random_decoders(0, use_direction=True), config, camera, {"preset": "draft", "seed": 7})


def test_a_scene_survives_the_file_bit_for_bit(scene: Scene, tmp_path: Path) -> None:
    path = tmp_path / "deeper" / "scene.safetensors"
    scene.save(path)
    again = Scene.load(path)
    for f in fields(GaussianAnchors):
        mine, theirs = getattr(scene.anchors, f.name), getattr(again.anchors, f.name)
        assert mine.dtype == theirs.dtype
        assert torch.equal(mine, theirs)
    for (name, mine), (other, theirs) in zip(scene.decoders.state_dict().items(), again.decoders.state_dict().items()):
        assert name == other
        assert torch.equal(mine, theirs)
    assert again.decoders.use_direction is True
    assert again.render_config == scene.render_config
    assert again.provenance == scene.provenance
    assert (again.camera.width, again.camera.height) == (33, 21)
    np.testing.assert_array_equal(again.camera.K, scene.camera.K)
    np.testing.assert_array_equal(again.camera.world_to_camera, scene.camera.world_to_camera)
    assert again.num_anchors == 80


def test_a_loaded_scene_renders_the_same_image(scene: Scene, tmp_path: Path) -> None:
    scene.save(tmp_path / "scene.safetensors")
    again = Scene.load(tmp_path / "scene.safetensors")
    image, other = (s.renderer().render(scene.camera) for s in (scene, again))
    np.testing.assert_array_equal(image.rgb, other.rgb)
    assert image.alpha.max() > 0.1


def test_the_same_scene_gives_the_same_bytes(scene: Scene, tmp_path: Path) -> None:
    first, second, third = (tmp_path / f"{n}.safetensors" for n in "abc")
    scene.save(first)
    replace(scene, provenance=dict(reversed(scene.provenance.items()))).save(second)  # the same facts, told backwards
    Scene.load(first).save(third)
    assert first.read_bytes() == second.read_bytes() == third.read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.safetensors", "b.safetensors", "c.safetensors"]


def test_saving_replaces_an_older_scene(scene: Scene, tmp_path: Path) -> None:
    path = tmp_path / "scene.safetensors"
    scene.save(path)
    replace(scene, provenance={"seed": 8}).save(path)
    assert Scene.load(path).provenance == {"seed": 8}


def test_colours_of_single_anchors(scene: Scene) -> None:
    plain = replace(scene, decoders=analytic_decoders(15.0, torch.Generator().manual_seed(0)))
    colours = plain.anchor_colors()
    assert colours.shape == (80, 3)
    np.testing.assert_allclose(colours, torch.sigmoid(scene.anchors.features[:, :3]).numpy(), atol=2e-7)


def _rewrite(path: Path, change: Callable[[dict[str, Any], dict[str, torch.Tensor]], None]) -> None:
    """Save a scene file again with its document and tensors changed."""
    with safe_open(str(path), framework="pt") as file:
        document = json.loads(file.metadata()["orca_scene"])
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a mapping
    change(document, tensors)
    save_file(tensors, str(path), {"orca_scene": json.dumps(document)})


def _without(key: str) -> Callable[[dict[str, Any], dict[str, torch.Tensor]], None]:
    return lambda document, tensors: (document if key in document else tensors).pop(key)


def _with(path: str, value: Any) -> Callable[[dict[str, Any], dict[str, torch.Tensor]], None]:
    def change(document: dict[str, Any], _: dict[str, torch.Tensor]) -> None:
        *parents, last = path.split(".")
        for parent in parents:
            document = document[parent]
        document[last] = value

    return change


def _shorten(name: str) -> Callable[[dict[str, Any], dict[str, torch.Tensor]], None]:
    def change(_: dict[str, Any], tensors: dict[str, torch.Tensor]) -> None:
        tensors[name] = tensors[name][:-1].contiguous()

    return change


def _rename(old: str, new: str) -> Callable[[dict[str, Any], dict[str, torch.Tensor]], None]:
    return lambda _, tensors: tensors.__setitem__(new, tensors.pop(old))


BROKEN = {
    "old schema": (_with("schema_version", 0), f"version {SCHEMA_VERSION}"),
    "newer schema": (_with("schema_version", SCHEMA_VERSION + 1), "reconstruct the scene again"),
    "no schema": (_without("schema_version"), "schema version None"),
    "no means": (_without("anchors.means"), "missing or broken part"),
    "short quaternions": (_shorten("anchors.quaternions"), "quaternions of shape"),
    "no decoder weight": (_without("decoders.colour_mid.weight"), "missing or broken part"),
    "short decoder weight": (_shorten("decoders.colour_out.weight"), "missing or broken part"),
    "stray decoder weight": (_rename("decoders.density_in.weight", "decoders.bias"), "missing or broken part"),
    "no camera": (_without("camera"), "missing or broken part"),
    "camera size in words": (_with("camera.width", "wide"), "missing or broken part"),
    "camera of no size": (_with("camera.width", 0), "check the camera file"),
    "ragged K": (_with("camera.K", [[1.0, 2.0], [3.0]]), "missing or broken part"),
    "unknown render option": (_with("render_config.shine", 1), "missing or broken part"),
    "no provenance": (_without("provenance"), "missing or broken part"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_scene_files_are_refused(scene: Scene, tmp_path: Path, name: str) -> None:
    change, message = BROKEN[name]
    path = tmp_path / "scene.safetensors"
    scene.save(path)
    _rewrite(path, change)
    with pytest.raises(BadInput, match=message):
        Scene.load(path)


def test_an_unchanged_rewrite_still_loads(scene: Scene, tmp_path: Path) -> None:
    """So that the refusals above come from the change and not from the rewriting."""
    scene.save(tmp_path / "scene.safetensors")
    _rewrite(tmp_path / "scene.safetensors", lambda document, tensors: None)
    assert Scene.load(tmp_path / "scene.safetensors").num_anchors == 80


@pytest.mark.parametrize(
    "metadata", [None, {"format": "pt"}, {"orca_scene": "{not json"}, {"orca_scene": "[]"}, {"orca_scene": "3"}]
)
def test_other_safetensors_are_refused(tmp_path: Path, metadata: dict[str, str] | None) -> None:
    path = tmp_path / "other.safetensors"
    save_file({"x": torch.zeros(3)}, str(path), metadata)
    with pytest.raises(BadInput, match="scene file"):
        Scene.load(path)


@pytest.mark.parametrize("content", [b"", b"hello", b"\xff" * 300])
def test_other_files_are_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "scene.safetensors"
    path.write_bytes(content)
    with pytest.raises(BadInput, match="is not a scene file"):
        Scene.load(path)


def test_a_truncated_scene_is_refused(scene: Scene, tmp_path: Path) -> None:
    path = tmp_path / "scene.safetensors"
    scene.save(path)
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(BadInput, match="is not a scene file"):
        Scene.load(path)


def test_missing_files_and_folders_are_refused(tmp_path: Path) -> None:
    for path in (tmp_path / "nowhere.safetensors", tmp_path):
        with pytest.raises(BadInput, match="is not a scene file"):
            Scene.load(path)
