"""The .ply export: the public layout, by hand and by round trip."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from orca.errors import BadInput
from orca.export import PLY_FIELDS, SH_C0, export_ply, read_ply


def fake_scene(n: int = 5) -> Any:
    """What the export reads of a scene: anchors, decoders and per-anchor colours."""
    generator = torch.Generator().manual_seed(0)
    anchors = SimpleNamespace(
        means=torch.randn(n, 3, generator=generator),
        log_variances=torch.randn(n, 3, generator=generator),
        quaternions=torch.randn(n, 4, generator=generator) * 3,
        opacity_logits=torch.randn(n, generator=generator),
        features=torch.zeros(n, 32),
        stage=torch.arange(n).remainder(3).to(torch.uint8),
    )
    colours = np.random.default_rng(0).random((n, 3), dtype=np.float32)
    return SimpleNamespace(
        anchors=anchors,
        decoders=lambda features: (torch.full((len(features),), 2.0), None),
        anchor_colors=lambda: colours,
    )


def test_header_is_the_3dgs_layout(tmp_path: Path) -> None:
    assert export_ply(fake_scene(), tmp_path / "s.ply") == 5
    head = (tmp_path / "s.ply").read_bytes().split(b"end_header\n")[0].decode().splitlines()
    assert head[:3] == ["ply", "format binary_little_endian 1.0", "element vertex 5"]
    names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"]
    names += ["scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    assert head[3:] == [f"property float {name}" for name in names]
    assert (tmp_path / "s.ply").stat().st_size == len("\n".join(head)) + 1 + len("end_header\n") + 5 * 17 * 4


def test_values_by_hand(tmp_path: Path) -> None:
    scene = fake_scene(1)
    scene.anchors.means[:] = torch.tensor([1.0, 2.0, 3.0])
    scene.anchors.log_variances[:] = math.log(0.04)
    scene.anchors.quaternions[:] = torch.tensor([0.0, 3.0, 0.0, 4.0])
    scene.anchors.opacity_logits[:] = 0.0
    scene.anchor_colors = lambda: np.array([[0.5, 1.0, 0.0]], np.float32)
    export_ply(scene, tmp_path / "s.ply")
    vertex = read_ply(tmp_path / "s.ply")[0]
    assert [vertex[n] for n in ("x", "y", "z", "nx", "ny", "nz")] == [1, 2, 3, 0, 0, 0]
    assert [vertex[f"f_dc_{i}"] for i in range(3)] == pytest.approx([0, 1.7724539, -1.7724539], abs=1e-5)
    assert vertex["scale_1"] == pytest.approx(math.log(0.2))
    assert [vertex[f"rot_{i}"] for i in range(4)] == pytest.approx([0, 0.6, 0, 0.8])
    alpha = 1 - math.exp(-2.0 * 0.5)
    assert vertex["opacity"] == pytest.approx(math.log(alpha / (1 - alpha)), rel=1e-5)


def test_round_trip(tmp_path: Path) -> None:
    scene = fake_scene(200)
    export_ply(scene, tmp_path / "s.ply")
    vertices = read_ply(tmp_path / "s.ply")
    assert vertices.dtype.names == PLY_FIELDS
    np.testing.assert_array_equal(np.stack([vertices[k] for k in "xyz"], 1), scene.anchors.means.numpy())
    colours = np.stack([vertices[f"f_dc_{i}"] for i in range(3)], 1) * SH_C0 + 0.5
    np.testing.assert_allclose(colours, scene.anchor_colors(), atol=1e-6)
    norms = sum(vertices[f"rot_{i}"].astype(float) ** 2 for i in range(4))
    np.testing.assert_allclose(norms, 1, atol=1e-6)


def test_an_opaque_anchor_stays_finite(tmp_path: Path) -> None:
    scene = fake_scene(3)
    scene.decoders = lambda features: (torch.tensor([0.0, 30.0, 1e6]), None)
    export_ply(scene, tmp_path / "s.ply")
    opacity = read_ply(tmp_path / "s.ply")["opacity"]
    assert np.isfinite(opacity).all()
    assert np.all(np.diff(opacity) >= 0)


def test_a_broken_scene_is_not_written(tmp_path: Path) -> None:
    scene = fake_scene()
    scene.anchors.means[2] = math.nan
    scene.anchors.quaternions[3] = 0
    with pytest.raises(BadInput, match="2 of 5 anchors"):
        export_ply(scene, tmp_path / "s.ply")
    assert list(tmp_path.iterdir()) == []


def test_bad_files_are_typed(tmp_path: Path) -> None:
    export_ply(fake_scene(), tmp_path / "s.ply")
    whole = (tmp_path / "s.ply").read_bytes()
    cases = {
        "short": whole[:-1],
        "text": b"hello",
        "ascii": whole.replace(b"binary_little_endian", b"ascii"),
        "faces": whole.replace(b"element vertex 5", b"element face 5"),
        "list": whole.replace(b"property float x", b"property list uchar int x"),
    }
    for name, content in cases.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(BadInput):
            read_ply(tmp_path / name)
    with pytest.raises(BadInput, match="cannot be read"):
        read_ply(tmp_path / "none.ply")
    with pytest.raises(BadInput, match="folder"):
        export_ply(fake_scene(), tmp_path)
