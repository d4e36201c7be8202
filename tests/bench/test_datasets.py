"""Data sets: what a case must be, the stereo pair's geometry, and a typed error for each kind of bad input."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from bench.datasets import DATASET_DESCRIPTIONS, DATASETS, SceneCase, open_dataset, resolve_data_root
from bench.datasets.motorcycle import fill_disparity, unreached
from bench.datasets.photos import package_file
from orca.errors import BadInput, OrcaError, Unavailable, Unknown
from orca.images import load_image
from orca.paths import scene_radius


def check_case(case: SceneCase) -> None:
    """What every case promises, whatever data set it is from."""
    assert case.image.dtype == np.uint8
    assert case.image.shape == (case.camera.height, case.camera.width, 3)
    assert case.depth.dtype == np.float32
    assert case.depth.shape == case.image.shape[:2]
    assert np.isfinite(case.depth).all()
    assert (case.depth > 0).all()
    np.testing.assert_array_equal(case.camera.world_to_camera, np.eye(4))
    np.testing.assert_allclose(case.trajectory.world_to_camera[0], np.eye(4), atol=1e-12)
    np.testing.assert_array_equal(case.trajectory.K[0], case.camera.K)
    assert (case.trajectory.width, case.trajectory.height) == (case.camera.width, case.camera.height)
    assert len(case.eval_indices) == 50
    assert case.eval_indices[0] == 0
    assert case.eval_indices[-1] == len(case.trajectory) - 1
    assert case.depth_source
    assert case.fov_source


def test_catalogue() -> None:
    assert (
        list(DATASETS)
        == list(DATASET_DESCRIPTIONS)
        == [
            "photos",
            "realmdreamer",
            "synthetic",
            "synthetic-unseen",
            "div2k",
            "div2k-subset",
            "folder",
        ]
    )
    with pytest.raises(Unknown, match="did you mean 'photos'"):
        open_dataset("photo")


def test_data_root_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", "/somewhere/cache")
    monkeypatch.delenv("ORCA_DATA_ROOT", raising=False)
    assert resolve_data_root(None) == Path("/somewhere/cache/orca")
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert resolve_data_root(None) == Path.home() / ".cache" / "orca"
    (tmp_path / "data").mkdir()
    assert resolve_data_root(None) == Path("data")
    monkeypatch.setenv("ORCA_DATA_ROOT", "/configured")
    assert resolve_data_root(None) == Path("/configured")
    assert resolve_data_root(Path("/given")) == Path("/given")


# --- photos ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def motorcycle() -> SceneCase:
    return open_dataset("photos").load("motorcycle")


@pytest.mark.parametrize("scene", ["motorcycle", "astronaut", "chelsea", "coffee", "rocket"])
def test_photos(scene: str) -> None:
    dataset = open_dataset("photos")
    assert scene in dataset.scenes()
    case = dataset.load(scene)
    check_case(case)
    assert (case.dataset, case.name) == ("photos", scene)
    assert scene_radius(case.depth, case.camera) == pytest.approx(1.0, rel=1e-5)
    assert case.depth_is_metric == (scene == "motorcycle")
    assert len(case.true_views) == (scene == "motorcycle")
    if scene != "motorcycle":
        assert "heuristic" in case.depth_source
        assert case.fov_source == "configured: 60 degrees"
        assert case.camera.hfov_deg == pytest.approx(60)


def test_photos_with_another_path_and_unknown_names() -> None:
    dataset = open_dataset("photos", trajectory="orbit")
    assert dataset.load("motorcycle").trajectory.name == "orbit"
    with pytest.raises(Unknown, match="did you mean 'motorcycle'"):
        dataset.load("motorcicle")
    with pytest.raises(Unknown, match="did you mean 'swing'"):
        open_dataset("photos", trajectory="swingg").load("motorcycle")


def test_missing_package_file() -> None:
    with pytest.raises(Unavailable, match=r"none\.png"):
        package_file("none.png")


def test_motorcycle_depth_is_the_calibrated_one(motorcycle: SceneCase) -> None:
    """z ratio of two pixels is the inverse ratio of d + 31.086."""
    disparity = np.load(package_file("motorcycle_disp.npz"))["arr_0"]
    (y0, x0), (y1, x1) = (100, 200), (400, 600)
    assert np.isfinite(disparity[[y0, y1], [x0, x1]]).all()
    ratio = (disparity[y1, x1] + 31.086) / (disparity[y0, x0] + 31.086)
    assert motorcycle.depth[y0, x0] / motorcycle.depth[y1, x1] == pytest.approx(ratio, rel=1e-5)


def test_motorcycle_pixels_land_at_x_minus_disparity(motorcycle: SceneCase) -> None:
    """The whole chain, K of both cameras, baseline, R: a lifted left pixel is seen at (x - d, y) on the right."""
    disparity = np.load(package_file("motorcycle_disp.npz"))["arr_0"]
    known = np.isfinite(disparity)
    y, x = np.nonzero(known)
    pixels = np.stack([x + 0.5, y + 0.5], axis=1)
    points = motorcycle.camera.unproject(pixels, motorcycle.depth[known])
    seen, depth = motorcycle.true_views[0].camera.project(points)
    np.testing.assert_allclose(seen[:, 0], x + 0.5 - disparity[known], atol=1e-3)
    np.testing.assert_allclose(seen[:, 1], y + 0.5, atol=1e-3)
    np.testing.assert_allclose(depth, motorcycle.depth[known], rtol=1e-6)


def test_motorcycle_photographs_agree_at_that_disparity(motorcycle: SceneCase) -> None:
    """The real right image, sampled at x - d, looks like the left one; at x + d or at x it does not."""
    depth, view = motorcycle.depth, motorcycle.true_views[0]
    y, x = np.indices(depth.shape)
    points = motorcycle.camera.unproject(np.stack([x.ravel() + 0.5, y.ravel() + 0.5], 1), depth.ravel())
    seen = view.camera.project(points)[0][:, 0].reshape(depth.shape) - 0.5
    error = {}
    for name, at in (("there", seen), ("mirrored", 2 * x - seen), ("unmoved", x.astype(np.float64))):
        sampled = cv2.remap(view.image, at.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR)
        inside = (at > 60) & (at < depth.shape[1] - 60)
        error[name] = float(np.median(np.abs(sampled.astype(int) - motorcycle.image)[inside]))
    assert error["there"] < 5
    assert error["there"] < 0.5 * min(error["mirrored"], error["unmoved"])


def test_motorcycle_hidden_region(motorcycle: SceneCase) -> None:
    hidden = motorcycle.true_views[0].hidden
    assert hidden.shape == motorcycle.image.shape[:2]
    assert hidden.mean() == pytest.approx(0.13, abs=0.005)
    assert hidden[:, -7:].all()  # the smallest disparity is 7.2 px: nothing reaches the right border
    assert hidden[:, -100:].mean() > 3 * hidden[:, :-100].mean()


def test_unreached_by_hand() -> None:
    disparity = np.array([[0.0, 0, 2, 0, 0], [1.0, 1, 1, 1, 1]])
    expected = np.array([[0, 0, 1, 0, 0], [0, 0, 0, 0, 1]], bool)  # 2 -> 0; everything one to the left
    np.testing.assert_array_equal(unreached(disparity), expected)


def test_fill_takes_the_nearest_and_keeps_the_known() -> None:
    disparity = np.array([[np.nan, 1.0, np.inf, np.inf, 5.0]])
    np.testing.assert_array_equal(fill_disparity(disparity), [[1, 1, 1, 5, 5]])


# --- realmdreamer ---------------------------------------------------------------------------------------------------


def test_realmdreamer(data_root: Path) -> None:
    dataset = open_dataset("realmdreamer", data_root=data_root)
    assert len(dataset.scenes()) == 11
    for scene in dataset.scenes():
        case = dataset.load(scene)
        check_case(case)
        assert case.image.shape == (512, 512, 3)
        published = json.loads((data_root / "vistadream" / "cameras" / f"{scene}.json").read_text())
        poses = np.asarray(published["world_to_camera"]).reshape(-1, 4, 4)
        assert np.abs(case.trajectory.world_to_camera - poses).max() < 1e-6
        assert np.abs(case.camera.K - np.asarray(published["K_512"])).max() < 1e-6
        if scene != "car":  # its far pixels lie outside what VistaDream's R is made of
            assert scene_radius(case.depth, case.camera) == pytest.approx(1.0, abs=0.02)


def test_realmdreamer_paths_and_names(data_root: Path) -> None:
    swung = open_dataset("realmdreamer", data_root=data_root, trajectory="swing").load("kitchen")
    assert swung.trajectory.name == "swing"
    with pytest.raises(Unknown, match="did you mean 'kitchen'"):
        open_dataset("realmdreamer", data_root=data_root).load("kitchn")


def fake_realmdreamer(root: Path) -> Path:
    base = root / "realmdreamer"
    (base / "images").mkdir(parents=True)
    (base / "depth").mkdir()
    entry = {"fx_512": 443.4, "forward_ratio": 0.2, "backward_ratio": 0.8}
    (base / "scenes.json").write_text(json.dumps({"car": entry}))
    image = np.random.default_rng(0).integers(0, 256, (64, 64, 3), dtype=np.uint8)
    cv2.imwrite(str(base / "images" / "car.png"), image)
    cv2.imwrite(str(base / "depth" / "car.png"), np.full((64, 64), 12345, np.uint16))
    return base


def test_realmdreamer_depth_unit_and_focal_length(tmp_path: Path) -> None:
    fake_realmdreamer(tmp_path)
    case = open_dataset("realmdreamer", data_root=tmp_path).load("car")
    check_case(case)
    np.testing.assert_allclose(case.depth, 1.2345, rtol=1e-6)
    assert case.camera.K[0, 0] == pytest.approx(443.4 / 8)


def test_empty_data_root(tmp_path: Path) -> None:
    dataset = open_dataset("realmdreamer", data_root=tmp_path)
    with pytest.raises(Unavailable, match=r"scenes\.json") as caught:
        dataset.scenes()
    assert str(tmp_path / "realmdreamer") in caught.value.allowed
    assert "--data-root" in caught.value.fix
    with pytest.raises(Unavailable):
        dataset.load("car")


def test_realmdreamer_missing_and_broken_files(tmp_path: Path) -> None:
    base = fake_realmdreamer(tmp_path)
    dataset = open_dataset("realmdreamer", data_root=tmp_path)
    with pytest.raises(BadInput, match="entry for 'bear'"):
        dataset.load("bear")
    depth = base / "depth" / "car.png"
    for wrong in (
        np.zeros((64, 64), np.uint16),
        np.full((64, 64), 100, np.uint8),
        np.full((32, 64), 100, np.uint16),
        np.full((64, 64, 3), 100, np.uint16),
    ):
        cv2.imwrite(str(depth), wrong)
        with pytest.raises(BadInput):
            dataset.load("car")
    depth.write_text("no image")
    with pytest.raises(BadInput):
        dataset.load("car")
    depth.unlink()
    with pytest.raises(Unavailable, match=r"car\.png"):
        dataset.load("car")
    (base / "images" / "car.png").write_text("no image")
    with pytest.raises(BadInput):
        dataset.load("car")
    for text in ("not json", "[]", '{"car": {"fx_512": 1}}', '{"car": {"fx_512": "x"}}'):
        (base / "scenes.json").write_text(text)
        with pytest.raises(BadInput):
            dataset.load("car")


# --- folder ---------------------------------------------------------------------------------------------------------


def write_image(path: Path, height: int = 40, width: int = 50) -> None:
    cv2.imwrite(str(path), np.random.default_rng(1).integers(0, 256, (height, width, 3), dtype=np.uint8))


def ramp(height: int = 40, width: int = 50) -> np.ndarray:
    return np.linspace(1.0, 3.0, height * width, dtype=np.float32).reshape(height, width)


def test_folder_lists_images_and_not_their_depth(tmp_path: Path) -> None:
    for name in ("b.png", "a.jpg", "a.depth.png", "b_depth.png", "c.JPEG"):
        write_image(tmp_path / name)
    (tmp_path / "notes.txt").write_text("x")
    (tmp_path / "sub.png").mkdir()
    assert open_dataset("folder", images=tmp_path).scenes() == ("a", "b", "c")


@pytest.mark.parametrize("ending", [".depth.npy", "_depth.npy", ".depth.png", "_depth.png"])
def test_folder_with_depth_in_any_unit(tmp_path: Path, ending: str) -> None:
    write_image(tmp_path / "a.png")
    if ending.endswith("npy"):
        np.save(tmp_path / f"a{ending}", ramp().astype(np.float64) * 250)
    else:
        cv2.imwrite(str(tmp_path / f"a{ending}"), np.round(ramp() * 20000).astype(np.uint16))
    case = open_dataset("folder", images=tmp_path).load("a")
    check_case(case)
    assert case.depth_is_metric
    assert case.depth_source == f"file a{ending}"
    np.testing.assert_allclose(case.depth / case.depth[0, 0], ramp() / ramp()[0, 0], rtol=1e-4)
    assert scene_radius(case.depth, case.camera) == pytest.approx(1.0, rel=1e-5)
    np.testing.assert_array_equal(case.image, load_image(tmp_path / "a.png"))


def test_folder_without_depth_is_a_named_guess(tmp_path: Path) -> None:
    write_image(tmp_path / "a.png")
    case = open_dataset("folder", images=tmp_path, trajectory="dolly").load("a")
    check_case(case)
    assert not case.depth_is_metric
    assert "heuristic" in case.depth_source
    assert case.trajectory.name == "dolly"


def wrong_depth(kind: str) -> np.ndarray:
    depth = ramp()
    if kind in ("nan", "inf", "zero", "negative"):
        depth[7, 9] = {"nan": np.nan, "inf": np.inf, "zero": 0.0, "negative": -1.0}[kind]
        return depth
    return {
        "size": ramp(50, 40),
        "channels": np.repeat(ramp()[..., None], 3, 2),
        "complex": ramp().astype(complex),
        "bool": ramp() > 0,
        "text": np.full((40, 50), "far"),
    }[kind]


@pytest.mark.parametrize("kind", ["nan", "inf", "zero", "negative", "size", "channels", "complex", "bool", "text"])
def test_folder_refuses_wrong_depth(tmp_path: Path, kind: str) -> None:
    write_image(tmp_path / "a.png")
    np.save(tmp_path / "a.depth.npy", wrong_depth(kind))
    with pytest.raises(BadInput) as caught:
        open_dataset("folder", images=tmp_path).load("a")
    if kind == "nan":
        assert "1 pixels" in caught.value.given
        assert "x=9, y=7" in caught.value.given


def test_folder_refuses_pickles_and_rubbish(tmp_path: Path) -> None:
    write_image(tmp_path / "a.png")
    write_image(tmp_path / "b.png")
    np.save(tmp_path / "a.depth.npy", np.array([{"x": 1}], object), allow_pickle=True)
    (tmp_path / "b.depth.png").write_text("no image")
    dataset = open_dataset("folder", images=tmp_path)
    for scene in "ab":
        with pytest.raises(BadInput):
            dataset.load(scene)
    (tmp_path / "a.depth.npy").write_bytes(b"")
    with pytest.raises(BadInput):
        dataset.load("a")


def test_folder_refuses_bad_images(tmp_path: Path) -> None:
    write_image(tmp_path / "tiny.png", 1, 1)
    (tmp_path / "text.png").write_text("no image")
    dataset = open_dataset("folder", images=tmp_path)
    assert dataset.scenes() == ("text", "tiny")
    for scene in dataset.scenes():
        with pytest.raises(BadInput):
            dataset.load(scene)


def test_folder_usage_errors(tmp_path: Path) -> None:
    cases: list[tuple[type[OrcaError], dict[str, object]]] = [
        (BadInput, {}),
        (BadInput, {"images": tmp_path / "none"}),
        (Unavailable, {"images": tmp_path}),
    ]
    for error, arguments in cases:
        with pytest.raises(error):
            open_dataset("folder", **arguments).scenes()  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="photos"):
        open_dataset("photos", images=tmp_path)
    write_image(tmp_path / "room.png")
    with pytest.raises(Unknown, match="did you mean 'room'"):
        open_dataset("folder", images=tmp_path).load("rom")
    write_image(tmp_path / "room.jpg")
    with pytest.raises(BadInput, match="two images of one name"):
        open_dataset("folder", images=tmp_path).scenes()
