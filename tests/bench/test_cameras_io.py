"""Cameras that other programs wrote, held against our own of the same view; and what is refused."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from bench.adapters.camera_match import frames_of_case, input_frame
from bench.cameras_io import find_camera_file, natural_key, read_camera_file
from bench.trajectories import save_trajectory
from orca.camera import Camera
from orca.errors import BadInput, OrcaError
from tests.bench.splat_files import flat_case


def cameras(n: int = 3, width: int = 40, height: int = 32) -> list[Camera]:
    rng = np.random.default_rng(0)
    out = []
    for _ in range(n):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3)
        out.append(Camera(np.array([[50.0, 0, 19], [0, 48, 17], [0, 0, 1]]), pose, width, height))
    return out


def write_colmap(folder: Path, views: list[Camera], names: list[str], model: str = "PINHOLE") -> None:
    folder.mkdir(parents=True, exist_ok=True)
    K = views[0].K
    lens = f"1 {model} {views[0].width} {views[0].height} {K[0, 0]} {K[1, 1]} {K[0, 2]} {K[1, 2]}"
    (folder / "cameras.txt").write_text(f"# Camera list\n#   CAMERA_ID, MODEL\n{lens}\n")
    lines = ["# Image list", "# two lines an image"]
    for index, (view, name) in enumerate(zip(views, names), start=1):
        q = Rotation.from_matrix(view.rotation).as_quat()[[3, 0, 1, 2]]
        numbers = " ".join(repr(float(v)) for v in (*q, *view.translation))
        lines += [f"{index} {numbers} 1 {name}", "10.5 20.5 -1 3 4 7" if index == 1 else ""]
    (folder / "images.txt").write_text("\n".join(lines) + "\n")


def write_nerfstudio(path: Path, views: list[Camera], names: list[str], **changes: object) -> None:
    K = views[0].K
    document: dict[str, object] = {
        **{"camera_model": "OPENCV", "fl_x": K[0, 0], "fl_y": K[1, 1], "cx": K[0, 2], "cy": K[1, 2]},
        **{"w": views[0].width, "h": views[0].height, "k1": 0.0, "p2": 0.0},
    }
    flip = np.diag([1.0, -1, -1, 1])
    frames = [
        {"file_path": f"images/{name}", "transform_matrix": (np.linalg.inv(view.world_to_camera) @ flip).tolist()}
        for view, name in zip(views, names)
    ]
    path.write_text(json.dumps({**document, "frames": frames, **changes}))


NAMES = ["frame_10.png", "frame_9.png", "frame_100.png"]
ORDER = [1, 0, 2]  # 9, 10, 100


@pytest.mark.parametrize("kind", ["colmap", "nerfstudio"])
def test_poses_and_intrinsics_come_through(tmp_path: Path, kind: str) -> None:
    views = cameras()
    if kind == "colmap":
        write_colmap(tmp_path / "sparse" / "0", views, NAMES)
    else:
        write_nerfstudio(tmp_path / "transforms.json", views, NAMES)
    found = find_camera_file(tmp_path)
    assert found is not None
    read = read_camera_file(found)
    assert [named.image for named in read] == ["frame_9.png", "frame_10.png", "frame_100.png"]
    for named, index in zip(read, ORDER, strict=True):
        np.testing.assert_allclose(named.camera.world_to_camera, views[index].world_to_camera, atol=1e-9)
        np.testing.assert_array_equal(named.camera.K, views[index].K)
        assert (named.camera.width, named.camera.height) == (40, 32)


def test_own_file_keeps_its_order(tmp_path: Path) -> None:
    case = flat_case()
    save_trajectory(case.trajectory, tmp_path / "cameras.json")
    found = find_camera_file(tmp_path)
    assert found == tmp_path / "cameras.json"
    read = read_camera_file(found)
    assert len(read) == 99
    np.testing.assert_array_equal(read[7].camera.world_to_camera, case.trajectory.world_to_camera[7])


def test_nerfstudio_from_an_angle(tmp_path: Path) -> None:
    """Blender's form: a horizontal field of view of 90 degrees is f = w / 2; the centre is the image's."""
    path = tmp_path / "transforms.json"
    write_nerfstudio(path, cameras(), NAMES, camera_angle_x=np.pi / 2)
    document = json.loads(path.read_text())
    for key in ("fl_x", "fl_y", "cx", "cy"):
        del document[key]
    path.write_text(json.dumps(document))
    K = read_camera_file(path)[0].camera.K
    np.testing.assert_allclose(K, [[20, 0, 20], [0, 20, 16], [0, 0, 1]])


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"k1": 0.1}, "distortion k1"),
        ({"camera_model": "OPENCV_FISHEYE"}, "OPENCV_FISHEYE"),
        ({"fl_x": float("nan")}, "fl_x is nan"),
        ({"fl_x": -5}, "focal"),
        ({"fl_x": "wide"}, "wide"),
        ({"w": 10**9}, "pixels"),
        ({"w": None}, "frame 0"),
        ({"frames": []}, "0 cameras"),
        ({"frames": [3]}, "frame 0"),
        ({"frames": [{"file_path": "a.png"}]}, "transform_matrix"),
        ({"frames": [{"file_path": "a.png", "transform_matrix": np.diag([2.0, 2, 2, 1]).tolist()}]}, "not a rotation"),
        ({"frames": [{"file_path": "a.png", "transform_matrix": [[1, 2], [3, 4]]}]}, "shape"),
        ({"frames": [{"transform_matrix": [[10**400] * 4] * 4}]}, "frame 0"),
    ],
)
def test_nerfstudio_refused(tmp_path: Path, changes: dict[str, object], said: str) -> None:
    path = tmp_path / "transforms.json"
    write_nerfstudio(path, cameras(), NAMES, **changes)
    with pytest.raises(BadInput, match=said):
        read_camera_file(path)


def test_colmap_refused(tmp_path: Path) -> None:
    for model, said in (("OPENCV", "camera model OPENCV"), ("SIMPLE_RADIAL", "SIMPLE_RADIAL")):
        write_colmap(tmp_path, cameras(), NAMES, model)
        with pytest.raises(BadInput, match=said):
            read_camera_file(tmp_path)
    write_colmap(tmp_path, cameras(), NAMES)
    images = (tmp_path / "images.txt").read_text()
    for old, new, said in (
        (" 1 frame_10.png", " 2 frame_10.png", "image 0"),
        (" 1 frame_10.png", "", "image 0"),
        ("\n1 ", "\n1 x", "image 0"),
    ):
        assert old in images
        (tmp_path / "images.txt").write_text(images.replace(old, new, 1))
        with pytest.raises(BadInput, match=said):
            read_camera_file(tmp_path)
    (tmp_path / "images.txt").write_text("1 0 0 0 0 0 0 0 1 a.png\n\n")
    with pytest.raises(BadInput, match="quaternion of length 0"):
        read_camera_file(tmp_path)


def test_files_that_are_none(tmp_path: Path) -> None:
    path = tmp_path / "cameras.json"
    for content, said in (
        (b"{", "not JSON"),
        (b"\xff\xfe", "cannot be read"),
        (b"[" * 10**5, "not JSON"),
        (b"[]", "holds a list"),
    ):
        path.write_bytes(content)
        with pytest.raises(BadInput, match=said):
            read_camera_file(path)
    path.write_bytes(b" " * (64 * 2**20 + 1))
    with pytest.raises(BadInput, match="bytes, where"):
        read_camera_file(path)
    with pytest.raises(BadInput, match="cannot be read"):
        read_camera_file(tmp_path / "none.json")
    assert find_camera_file(tmp_path / "nowhere") is None


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    document=st.recursive(
        st.none() | st.floats() | st.integers() | st.text(max_size=5),
        lambda c: (
            st.lists(c)
            | st.dictionaries(
                st.sampled_from(
                    [
                        "frames",
                        "w",
                        "h",
                        "fl_x",
                        "K",
                        "world_to_camera",
                        "name",
                        "width",
                        "height",
                        "transform_matrix",
                        "K_512",
                        "image_size",
                        "video",
                    ]
                ),
                c,
            )
        ),
        max_leaves=12,
    )
)
def test_any_json_is_read_or_refused(tmp_path: Path, document: object) -> None:
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps(document))
    with contextlib.suppress(OrcaError):
        read_camera_file(path)


@given(st.lists(st.integers(0, 10**6), min_size=1, max_size=20, unique=True))
def test_natural_order_is_the_order_of_the_numbers(numbers: list[int]) -> None:
    names = [f"frame_{n}.png" for n in numbers]
    assert sorted(names, key=natural_key) == [f"frame_{n}.png" for n in sorted(numbers)]


def test_matching_the_whole_path_or_its_evaluated_part() -> None:
    case = flat_case()
    assert frames_of_case(case, case.trajectory.cameras(), "f") == case.eval_indices
    assert frames_of_case(case, case.eval_trajectory.cameras(), "f") == (0, 1, 2, 3)
    assert input_frame(case, 99) == 0
    twice = [camera.resized(80, 64) for camera in case.trajectory.cameras()]
    assert frames_of_case(case, twice, "f") == case.eval_indices


def test_another_world_is_the_same_view_and_another_unit_is_not() -> None:
    case = flat_case()
    world = np.eye(4)
    world[:3, :3], world[:3, 3] = Rotation.from_euler("xyz", (30, 40, 50), degrees=True).as_matrix(), (1, 2, 3)
    turned = [Camera(c.K, c.world_to_camera @ world, c.width, c.height) for c in case.trajectory.cameras()]
    assert frames_of_case(case, turned, "f") == case.eval_indices
    scaled = []
    for c in case.trajectory.cameras():
        pose = c.world_to_camera.copy()
        pose[:3, 3] *= 3.5
        scaled.append(Camera(c.K, pose, c.width, c.height))
    with pytest.raises(BadInput, match=r"3\.5 times as large: another unit"):
        frames_of_case(case, scaled, "f")


def test_the_first_differing_frame_is_named() -> None:
    case = flat_case()
    views = list(case.trajectory.cameras())
    pose = views[41].world_to_camera.copy()
    pose[0, 3] += 0.01
    views[41] = Camera(views[41].K, pose, 40, 32)
    with pytest.raises(BadInput, match="the pose of frame 41 "):
        frames_of_case(case, views, "f")
    views[5] = Camera(views[5].K * np.array([[1.1], [1], [1]]), views[5].world_to_camera, 40, 32)
    with pytest.raises(BadInput, match="the K of frame 5 "):
        frames_of_case(case, views, "f")
    with pytest.raises(BadInput, match="98 cameras in f"):
        frames_of_case(case, views[:-1], "f")
