"""Other methods' splats: the renderer against a slow one of its own, both file formats, and where splats are placed."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bench.adapters import METHODS, RunOptions
from bench.adapters.gaussian_ply import read_gaussian_ply
from bench.adapters.splat_cloud import SplatCloud, sh_basis
from bench.adapters.vistadream_scene import read_vistadream_scene
from bench.splatting import place, render_cloud
from orca.camera import Camera
from orca.errors import BadInput, Unavailable
from tests.bench.splat_files import cloud_of, flat_case, render_slowly, save_vistadream_scene, write_ply


def turned(camera: Camera, angles: tuple[float, float, float], shift: tuple[float, float, float]) -> Camera:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_euler("xyz", angles, degrees=True).as_matrix(), shift
    return dataclasses.replace(camera, world_to_camera=pose)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_renderer_against_the_slow_one(degree: int) -> None:
    cloud = cloud_of(25, degree, seed=degree)
    camera = turned(Camera.from_fov(21, 19, 55.0), (4, -6, 3), (0.2, -0.1, 0.1))
    view = render_cloud(cloud, camera)
    rgb, alpha, depth = render_slowly(cloud, camera)
    assert alpha.max() > 0.5 > alpha.min()
    np.testing.assert_allclose(view.rgb, rgb, atol=2e-5)
    np.testing.assert_allclose(view.alpha, alpha, atol=2e-5)
    np.testing.assert_allclose(view.depth, depth, atol=2e-3)  # a sum of a few products in float32, then a quotient


def test_harmonics_are_orthonormal() -> None:
    """By Gauss-Legendre quadrature over the sphere, exact for these polynomials."""
    nodes, weights = np.polynomial.legendre.leggauss(16)
    phi = np.arange(32) * 2 * np.pi / 32
    z, angle = (a.ravel() for a in np.meshgrid(nodes, phi, indexing="ij"))
    r = np.sqrt(1 - z * z)
    basis = sh_basis(np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1), 16)
    gram = (basis * np.repeat(weights, 32)[:, None] * 2 * np.pi / 32).T @ basis
    np.testing.assert_allclose(gram, np.eye(16), atol=1e-12)


def test_one_splat_by_hand() -> None:
    """A round splat of standard deviation 2 px in the middle of a pixel: alpha = o exp(-d^2 / (2 (4 + 0.3)))."""
    camera = Camera(np.array([[100.0, 0, 10.5], [0, 100, 10.5], [0, 0, 1]]), np.eye(4), 21, 21)
    one = cloud_of(1)
    one = dataclasses.replace(
        one,
        means=np.array([[0, 0, 2]], np.float32),
        log_scales=np.full((1, 3), math.log(0.04), np.float32),
        opacity_logits=np.array([0.0], np.float32),
    )
    view = render_cloud(one, camera)
    for dx in range(-4, 5):
        assert view.alpha[10, 10 + dx] == pytest.approx(0.5 * math.exp(-dx * dx / 8.6), abs=1e-6)
    assert view.depth[10, 10] == pytest.approx(2.0)


def test_transparent_far_and_flat_splats_are_no_trouble() -> None:
    cloud = cloud_of(6)
    means = np.array([[0, 0, 2], [0, 0, -2], [1e6, 0, 1], [0, 0, 1e9], [0, 0, 0.0], [0, 0, 3]], np.float32)
    logits = np.array([-np.inf, 5, 5, 5, 5, np.inf], np.float32)
    scales = cloud.log_scales.copy()
    scales[5] = [-40, 0, 0]
    cloud = dataclasses.replace(cloud, means=means, opacity_logits=logits, log_scales=scales).usable()
    view = render_cloud(cloud, Camera.from_fov(16, 16, 60.0))
    assert np.isfinite(view.rgb).all()
    assert 0.9 < view.alpha.max() <= 0.99  # the opaque disc at z = 3, seen through all the rest


def test_what_cannot_be_drawn_is_left_out_and_counted() -> None:
    cloud = cloud_of(8)
    for name, row in (("means", 0), ("log_scales", 1), ("quaternions", 2), ("sh", 3), ("opacity_logits", 4)):
        getattr(cloud, name)[row] = np.nan
    cloud.quaternions[5] = 0
    cloud.log_scales[6] = 50
    kept = cloud.usable()
    assert (len(kept), kept.dropped) == (1, 7)
    kept.means[:] = np.inf
    with pytest.raises(BadInput, match="none of them finite"):
        kept.usable()


@pytest.mark.parametrize("unit", [1e-3, 1.0, 250.0])
def test_placement_undoes_the_unit(unit: float) -> None:
    """A wall of splats at twice the reference depth, in any unit, is placed at the reference depth."""
    case = flat_case(depth=0.7)
    cloud = wall(1.4 * unit)
    placed, placement = place(cloud, case.camera, case.depth)
    assert placement.scale == pytest.approx(2 * unit, rel=1e-3)
    assert placement.spread == pytest.approx(1, abs=1e-3)
    view = render_cloud(placed, case.camera)
    assert np.median(view.depth) == pytest.approx(0.7, rel=1e-3)


def wall(z: float) -> SplatCloud:
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(-1, 1, 25), np.linspace(-1, 1, 25)))
    cloud = cloud_of(len(x))
    return dataclasses.replace(
        cloud,
        means=(np.stack([x * z, y * z, np.full_like(x, z)], axis=1)).astype(np.float32),
        log_scales=np.full((len(x), 3), math.log(0.05 * z), np.float32),
        opacity_logits=np.full(len(x), 3, np.float32),
    )


def test_placement_needs_splats_in_view() -> None:
    case = flat_case()
    behind = dataclasses.replace(wall(1.0), means=-wall(1.0).means)
    with pytest.raises(BadInput, match="behind the input camera"):
        place(behind, case.camera, case.depth)
    aside = dataclasses.replace(wall(1.0), means=wall(1.0).means + np.float32([50, 0, 0]))
    with pytest.raises(BadInput, match=r"cover 0\.0 %"):
        place(aside, case.camera, case.depth)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_ply_round_trip(tmp_path: Path, degree: int) -> None:
    cloud = cloud_of(7, degree)
    write_ply(tmp_path / "a.ply", cloud)
    read = read_gaussian_ply(tmp_path / "a.ply")
    for name in ("means", "log_scales", "quaternions", "opacity_logits", "sh"):
        np.testing.assert_array_equal(getattr(read, name), getattr(cloud, name))


def test_ply_of_another_program(tmp_path: Path) -> None:
    """The same file by way of plyfile, with its properties in another order and as doubles."""
    plyfile = pytest.importorskip("plyfile")
    cloud = cloud_of(5, 1)
    write_ply(tmp_path / "a.ply", cloud)
    table = plyfile.PlyData.read(str(tmp_path / "a.ply"))["vertex"].data
    shuffled = np.zeros(len(table), [(name, "f8") for name in reversed(table.dtype.names)])
    for name in table.dtype.names:
        shuffled[name] = table[name]
    element = plyfile.PlyElement.describe(shuffled, "vertex")
    plyfile.PlyData([element], byte_order="<").write(str(tmp_path / "b.ply"))
    np.testing.assert_array_equal(read_gaussian_ply(tmp_path / "b.ply").sh, cloud.sh)


def test_broken_plys(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    write_ply(path, cloud_of(5, 1))
    whole = path.read_bytes()
    for old, new, said in (
        (b"element vertex 5", b"element vertex 6", "ends after 5 of 6"),
        (b"element vertex 5", b"element vertex 99999999999999999", "claims 9999"),
        (b"element vertex 5", b"element vertex -5", "claims no vertices"),
        (b"element vertex 5", b"element face 5", "claims no vertices"),
        (b"binary_little_endian", b"ascii", "no binary .ply"),
        (b"f_rest_8", b"f_rust_8", "8 f_rest"),
        (b"rot_3", b"rut_3", "without rot_3"),
        (b"property float opacity", b"property list uchar int opacity", "plain numbers"),
        (b"end_header", b"and_header", "no binary .ply"),
    ):
        path.write_bytes(whole.replace(old, new, 1))
        with pytest.raises(BadInput, match=said):
            read_gaussian_ply(path)
    with pytest.raises(BadInput, match="cannot be read"):
        read_gaussian_ply(tmp_path / "none.ply")


def test_vistadream_scene_equals_the_same_splats_as_ply(tmp_path: Path) -> None:
    cloud = cloud_of(31)
    cloud = dataclasses.replace(cloud, sh=np.clip(cloud.sh, -1.5, 1.5))
    save_vistadream_scene(tmp_path / "scene.pth", cloud, frames=3)
    read = read_vistadream_scene(tmp_path / "scene.pth")
    np.testing.assert_array_equal(read.means, cloud.means)
    np.testing.assert_array_equal(read.opacity_logits, cloud.opacity_logits)
    np.testing.assert_allclose(read.sh, cloud.sh, atol=2e-6)
    camera = Camera.from_fov(16, 12, 60.0)
    np.testing.assert_allclose(render_cloud(read, camera).rgb, render_cloud(cloud, camera).rgb, atol=1e-5)


def test_vistadream_scene_with_infinities_and_another_first_pose(tmp_path: Path) -> None:
    cloud = cloud_of(12)
    cloud.means[3] = np.inf
    pose = turned(Camera.from_fov(9, 9, 60.0), (10, 0, 0), (0, 0, 0.5)).world_to_camera
    save_vistadream_scene(tmp_path / "scene.pth", cloud, pose=pose)
    read = read_vistadream_scene(tmp_path / "scene.pth")
    assert (len(read), read.dropped) == (11, 1)
    np.testing.assert_array_equal(read.input_pose, pose)


def test_methods_render_the_case(tmp_path: Path) -> None:
    """The same wall as .ply and as scene.pth, in metres and in millimetres: the same frames."""
    case = flat_case()
    write_ply(tmp_path / "p" / "wall.ply", wall(1.0))
    save_vistadream_scene(tmp_path / "v" / "wall" / "scene.refine.pth", wall(1000.0))
    seen: list[tuple[str, int, int]] = []
    options = RunOptions(progress=lambda *what: seen.append(what))
    outputs = [
        METHODS.get(f"{spec}:{tmp_path / folder}").run(case, options)
        for spec, folder in (("ply", "p"), ("vistadream-scene", "v"))
    ]
    first, second = outputs
    assert first.frames.shape == (4, 32, 40, 3)
    assert first.coverage is not None
    assert first.coverage.shape == (4, 32, 40)
    assert first.input_view is not None
    assert first.model["anchors"] == 625
    assert first.model["placement_scale"] == pytest.approx(0.5, rel=1e-3)
    assert second.model["placement_scale"] == pytest.approx(500, rel=1e-3)
    assert seen[-1] == ("render", 5, 5)
    difference = np.abs(first.frames.astype(int) - second.frames.astype(int))
    assert difference.max() <= 2  # scene.pth keeps colours within (0, 1); these are cut at 0.01 and 0.99 by the test
    assert first.frames.std() > 5


def test_cameras_beside_a_ply_place_it(tmp_path: Path) -> None:
    """The same splats in a turned world, with the input view's camera in that world: the same frames."""
    case = flat_case()
    plain, moved = tmp_path / "plain", tmp_path / "moved"
    cloud = wall(2.0)
    # No two at one depth: rounding would order them otherwise in the turned world.
    cloud.means[:, 2] += np.random.default_rng(0).permutation(len(cloud)) * np.float32(1e-3)
    write_ply(plain / "wall.ply", cloud)
    R = Rotation.from_euler("xyz", (20, -35, 50), degrees=True)
    t = np.array([1.0, -2.0, 0.5])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = R.as_matrix(), t
    world = R.inv().apply(cloud.means.astype(float) - t).astype(np.float32)
    q = (R.inv() * Rotation.from_quat(cloud.quaternions[:, [1, 2, 3, 0]])).as_quat()[:, [3, 0, 1, 2]]
    write_ply(moved / "wall.ply", dataclasses.replace(cloud, means=world, quaternions=q.astype(np.float32)))
    document = {"name": "input", "width": 40, "height": 32, "K": case.camera.K.tolist()}
    (moved / "wall.json").write_text(json.dumps({**document, "world_to_camera": [pose.tolist()]}))
    a, b = (METHODS.get(f"ply:{folder}").run(case, RunOptions()).frames for folder in (plain, moved))
    assert np.abs(a.astype(int) - b.astype(int)).max() <= 1


def test_missing_and_double_files(tmp_path: Path) -> None:
    case = flat_case()
    (tmp_path / "wall").mkdir()
    for kind, said in (("ply", "no splat file"), ("vistadream-scene", "refine scene"), ("orca-scene", "no scene file")):
        with pytest.raises(Unavailable, match=said):
            METHODS.get(f"{kind}:{tmp_path}").run(case, RunOptions())
    for name in ("one", "two"):
        write_ply(tmp_path / "wall" / f"{name}.ply", wall(1.0))
    with pytest.raises(BadInput, match="2 files for scene"):
        METHODS.get(f"ply:{tmp_path}").run(case, RunOptions())
    with pytest.raises(BadInput, match="plain file name"):
        METHODS.get(f"vistadream-scene:{tmp_path}").run(dataclasses.replace(case, name="../wall"), RunOptions())
