"""ORCA scene files as a method: the frames of the renderer itself, and another unit of depth undone."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from bench.adapters import METHODS, RunOptions
from orca.anchors import GaussianAnchors
from orca.config import RenderConfig
from orca.conventions import to_uint8
from orca.errors import BadInput, Unavailable
from orca.field.decoders import analytic_decoders
from orca.render.surroundings import as_shown
from orca.scene import Scene
from tests.bench.splat_files import flat_case


def wall_scene(z: float) -> Scene:
    """Anchors of random features on the plane z, larger than the view."""
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(-0.8, 0.8, 24), np.linspace(-0.8, 0.8, 24)))
    n = len(x)
    generator = torch.Generator().manual_seed(0)
    anchors = GaussianAnchors(
        means=torch.from_numpy(np.stack([x * z, y * z, np.full(n, z)], axis=1).astype(np.float32)),
        log_variances=torch.full((n, 3), 2 * float(np.log(0.04 * z))),
        quaternions=torch.tensor([1.0, 0, 0, 0]).repeat(n, 1),
        opacity_logits=torch.full((n,), 3.0),
        features=torch.randn(n, 32, generator=generator),
        stage=torch.zeros(n, dtype=torch.uint8),
    )
    anchors.features[:, 3] = 1.0
    return Scene(anchors, analytic_decoders(8.0, generator), RenderConfig(), flat_case().camera, {"preset": "test"})


def test_frames_of_a_scene_file(tmp_path: Path) -> None:
    case = flat_case(depth=1.0)
    scene = wall_scene(1.0)
    scene.save(tmp_path / "wall.safetensors")
    output = METHODS.get(f"orca-scene:{tmp_path}").run(case, RunOptions())
    renderer = scene.renderer()
    for frame, camera in zip(output.frames, case.eval_trajectory.cameras(), strict=True):
        shown = as_shown(renderer.render(camera), scene.render_config)
        np.testing.assert_array_equal(frame, to_uint8(shown.rgb))
    assert output.model["anchors"] == 576
    assert output.model["placement_scale"] == 1.0
    assert output.model["placement_spread"] == pytest.approx(1, abs=0.05)
    assert output.coverage is not None


def test_a_scene_in_another_unit_is_placed(tmp_path: Path) -> None:
    """The same wall, three times as far and as large: the same frames, since near does not matter here."""
    case = flat_case(depth=1.0)
    wall_scene(1.0).save(tmp_path / "a" / "wall.safetensors")
    wall_scene(3.0).save(tmp_path / "b" / "wall" / "scene.safetensors")
    near, far = (METHODS.get(f"orca-scene:{tmp_path / name}").run(case, RunOptions()) for name in "ab")
    assert far.model["placement_scale"] == pytest.approx(3, rel=0.02)
    assert np.abs(near.frames.astype(int) - far.frames.astype(int)).mean() < 1.5


def test_files_that_are_none(tmp_path: Path) -> None:
    method = METHODS.get(f"orca-scene:{tmp_path}")
    with pytest.raises(Unavailable, match="no scene file"):
        method.run(flat_case(), RunOptions())
    (tmp_path / "wall.safetensors").write_bytes(b"\x08\0\0\0\0\0\0\0{}      ")
    with pytest.raises(BadInput, match="is not a scene file"):
        method.run(flat_case(), RunOptions())
    aside = wall_scene(1.0)
    means = aside.anchors.means + torch.tensor([50.0, 0, 0])
    dataclasses.replace(aside, anchors=dataclasses.replace(aside.anchors, means=means)).save(
        tmp_path / "wall.safetensors"
    )
    with pytest.raises(BadInput, match="shows nothing"):
        method.run(flat_case(), RunOptions())
