"""Depth providers: what the numbers in a file or a network's output become, and what is refused."""

from __future__ import annotations

import json
import logging
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.stats import spearmanr

from orca.camera import Camera
from orca.conventions import to_float
from orca.errors import BadInput, Unavailable, Unknown
from orca.images import load_image
from orca.priors.depth import DEPTH_PROVIDERS, DepthEstimate, inverse_to_depth, parse_depth_spec
from orca.priors.heuristic import sky_mask
from tests.orca.tiny_onnx import write_channel_mixer

H, W = 20, 32
CAMERA = Camera.from_fov(W, H, 60)
IMAGE = np.random.default_rng(1).random((H, W, 3), dtype=np.float32)


def estimate(spec: str) -> DepthEstimate:
    return parse_depth_spec(spec).estimate(IMAGE, CAMERA)


def save(path: Path, values: np.ndarray) -> Path:
    if path.suffix == ".npy":
        np.save(path, values)
    else:
        assert cv2.imwrite(str(path), values)
    return path


def ramp(dtype: type = np.uint16, height: int = H, width: int = W) -> np.ndarray:
    return (np.arange(height * width).reshape(height, width) % 200 + 50).astype(dtype)


def test_every_registered_provider_can_be_built() -> None:
    specs = {"file": "file:a.npy", "onnx": "onnx:a.onnx?size=8&range=1&meaning=depth"}
    for name in DEPTH_PROVIDERS:
        assert parse_depth_spec(specs.get(name, name)).name == name


@pytest.mark.parametrize(("suffix", "dtype"), [(".png", np.uint8), (".png", np.uint16), (".npy", np.float64)])
def test_file_depth_is_value_times_unit(tmp_path: Path, suffix: str, dtype: type) -> None:
    path = save(tmp_path / f"d{suffix}", ramp(dtype))
    result = estimate(f"file:{path}?unit=0.01&meaning=depth")
    np.testing.assert_allclose(result.depth, ramp(np.float64) * 0.01, rtol=1e-6)
    assert result.depth.dtype == np.float32
    assert result.is_metric
    assert result.notes == ()


def test_an_undeclared_unit_is_noted(tmp_path: Path) -> None:
    result = estimate(f"file:{save(tmp_path / 'd.png', ramp())}")
    np.testing.assert_array_equal(result.depth, ramp())
    assert "unit" in result.notes[0]


def test_meanings_by_hand(tmp_path: Path) -> None:
    path = save(tmp_path / "d.npy", np.full((H, W), 4.0))
    assert estimate(f"file:{path}?meaning=inverse_depth&unit=0.5").depth[0, 0] == pytest.approx(0.5)
    stereo = estimate(f"file:{path}?meaning=disparity&focal=1000&baseline=0.2&offset=6")
    assert stereo.depth[3, 3] == pytest.approx(1000 * 0.2 / (4 + 6))
    assert stereo.is_metric
    relative = estimate(f"file:{path}?meaning=disparity")
    assert relative.depth[0, 0] == pytest.approx(0.25)
    assert not relative.is_metric
    assert estimate(f"file:{path}?meaning=disparity&metric=1&hfov=47").is_metric
    assert estimate(f"file:{path}?hfov=47").hfov_deg == 47


def test_broken_values_are_counted_or_filled(tmp_path: Path) -> None:
    values = ramp(np.float32)
    values[4, 4:7] = np.nan, np.inf, -1
    path = save(tmp_path / "d.npy", values)
    with pytest.raises(BadInput, match=r"3 of 640 values.*1 NaN, 1 infinite"):
        estimate(f"file:{path}")
    result = estimate(f"file:{path}?fill=1")
    good = np.isfinite(values) & (values > 0)
    np.testing.assert_array_equal(result.depth[good], values[good])
    neighbours = {values[4, 3], values[4, 7], *values[3, 4:7], *values[5, 4:7]}
    assert set(result.depth[4, 4:7].tolist()) <= neighbours
    assert "3 of 640" in result.notes[0]


def test_zero_inverse_depth_is_far_when_filled(tmp_path: Path) -> None:
    values = np.full((H, W), 2.0)
    values[:5] = 0
    result = estimate(f"file:{save(tmp_path / 'd.npy', values)}?meaning=inverse_depth&fill=1")
    assert result.depth[-1, 0] == pytest.approx(0.5)
    assert result.depth[0, 0] == pytest.approx(5.0)


def test_another_size_needs_resize(tmp_path: Path) -> None:
    path = save(tmp_path / "d.png", np.kron(ramp(), np.ones((2, 2), np.uint16)).astype(np.uint16))
    with pytest.raises(BadInput, match="64x40 for an image of 32x20"):
        estimate(f"file:{path}")
    np.testing.assert_array_equal(estimate(f"file:{path}?resize=1").depth, ramp())
    wide = save(tmp_path / "wide.png", ramp(np.uint16, H, 2 * W))
    with pytest.raises(BadInput, match="proportions"):
        estimate(f"file:{wide}?resize=1")


def test_a_resized_disparity_counts_pixels_of_the_image(tmp_path: Path) -> None:
    path = save(tmp_path / "d.npy", np.full((2 * H, 2 * W), 8.0))
    result = estimate(f"file:{path}?meaning=disparity&focal=100&baseline=1&resize=1")
    assert result.depth[0, 0] == pytest.approx(100 / 4)


def test_files_that_are_no_depth(tmp_path: Path) -> None:
    colour = save(tmp_path / "colour.png", (IMAGE * 255).astype(np.uint8))
    (tmp_path / "text.png").write_text("no")
    (tmp_path / "empty.png").write_bytes(b"")
    (tmp_path / "text.npy").write_text("no")
    words = save(tmp_path / "words.npy", np.array([["a", "b"]]))
    pickled = tmp_path / "pickled.npy"
    np.save(pickled, np.array([{"a": 1}], dtype=object), allow_pickle=True)
    nothing = save(tmp_path / "nan.npy", np.full((H, W), np.nan))
    names = [colour, tmp_path / "text.png", tmp_path / "empty.png", tmp_path / "text.npy", words, pickled, nothing]
    for path in [*names, tmp_path / "none.png", tmp_path / "d.exr"]:
        with pytest.raises(BadInput) as caught:
            estimate(f"file:{path}?fill=1")
        assert len(str(caught.value).splitlines()) == 3, path


@pytest.mark.parametrize(
    ("spec", "error", "message"),
    [
        ("fiel:a.png", Unknown, "did you mean 'file'"),
        ("file", BadInput, "without a file"),
        ("", BadInput, "begin with a name"),
        ("file:a.png?unti=2", Unknown, "did you mean 'unit'"),
        ("file:a.png?unit=0", BadInput, "unit=0"),
        ("file:a.png?unit=nan", BadInput, "unit=nan"),
        ("file:a.png?unit=x", BadInput, "unit=x"),
        ("file:a.png?unit=1&unit=2", BadInput, "each once"),
        ("file:a.png?meaning=deep", BadInput, "inverse_depth"),
        ("file:a.png?fill=yes", BadInput, "0 | 1"),
        ("file:a.png?focal=9", BadInput, "both or neither"),
        ("onnx:a.onnx", BadInput, "without size"),
        ("onnx:a.onnx?size=384&range=255", BadInput, "without meaning"),
        ("onnx:a.onnx?size=-3&range=255&meaning=depth", BadInput, "size=-3"),
        ("heuristic?sky=1", Unknown, "no option"),
        ("constant?z=-1", BadInput, "z=-1"),
    ],
)
def test_bad_specifications(spec: str, error: type[Exception], message: str) -> None:
    with pytest.raises(error) as caught:
        parse_depth_spec(spec)
    assert message in str(caught.value)


def test_a_path_may_hold_a_question_mark(tmp_path: Path) -> None:
    path = save(tmp_path / "what?.npy", ramp(np.float32))
    np.testing.assert_array_equal(estimate(f"file:{path}").depth, ramp())
    np.testing.assert_array_equal(estimate(f"file:{path}?unit=2").depth, 2.0 * ramp())


def test_estimates_check_themselves() -> None:
    with pytest.raises(BadInput, match="1 of 4 values"):
        DepthEstimate(np.array([[1, 2], [0, 3]], np.float32), "x", True)
    with pytest.raises(BadInput, match="shape"):
        DepthEstimate(np.ones((2, 2, 1), np.float32), "x", True)


def test_inverse_depth_is_floored_at_a_stated_far_bound() -> None:
    inverse = np.array([[0.0, 0.01, 1.0], [1.0, 1.0, 2.0]], np.float32)
    np.testing.assert_allclose(inverse_to_depth(inverse), [[10, 10, 1], [1, 1, 0.5]], rtol=1e-6)
    with pytest.raises(BadInput, match="single positive"):
        inverse_to_depth(np.zeros((3, 3), np.float32))


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ("range=1&meaning=depth", 0.5 + 2 * 0.25),
        ("range=255&meaning=depth", 255 * (0.5 + 2 * 0.25)),
        ("range=1&meaning=depth&order=bgr", 0.75 + 2 * 0.25),
        ("range=imagenet&meaning=depth", (0.5 - 0.485) / 0.229 + 2 * (0.25 - 0.456) / 0.224 + 5),
    ],
)
def test_onnx_input_range_and_order(tmp_path: Path, options: str, expected: float) -> None:
    weights = (1.0, 2.0, 5 / ((0.75 - 0.406) / 0.225) if "imagenet" in options else 0.0)
    write_channel_mixer(tmp_path / "n.onnx", weights)
    image = np.broadcast_to(np.array([0.5, 0.25, 0.75], np.float32), (H, W, 3))
    result = parse_depth_spec(f"onnx:{tmp_path / 'n.onnx'}?size=8&{options}").estimate(image, CAMERA)
    assert result.depth.shape == (H, W)
    np.testing.assert_allclose(result.depth, expected, rtol=1e-5)
    assert result.is_metric


def test_onnx_relative_inverse_depth(tmp_path: Path) -> None:
    write_channel_mixer(tmp_path / "n.onnx", (1.0, 0.0, 0.0))
    image = np.zeros((H, W, 3), np.float32)
    image[H // 2 :, :, 0] = 0.5
    image[-2:, :, 0] = 1.0
    spec = f"onnx:{tmp_path / 'n.onnx'}?size=8&range=255&meaning=inverse_depth"
    result = parse_depth_spec(spec).estimate(image, CAMERA)
    assert not result.is_metric
    assert np.median(result.depth) == pytest.approx(1.0)
    assert result.depth[0, 0] / result.depth[H * 3 // 4, 0] == pytest.approx(10, rel=0.1)  # sky: a stated far bound
    assert result.depth[-1, 0] < result.depth[H * 3 // 4, 0]


def test_onnx_failures_are_typed(tmp_path: Path) -> None:
    write_channel_mixer(tmp_path / "n.onnx", (-1.0, 0.0, 0.0))
    (tmp_path / "junk.onnx").write_text("junk")
    options = "size=8&range=1&meaning=inverse_depth"
    with pytest.raises(Unavailable, match="does not exist"):
        estimate(f"onnx:{tmp_path / 'none.onnx'}?{options}")
    with pytest.raises(BadInput, match="not an ONNX network"):
        estimate(f"onnx:{tmp_path / 'junk.onnx'}?{options}")
    with pytest.raises(BadInput, match="single positive"):
        estimate(f"onnx:{tmp_path / 'n.onnx'}?{options}")
    with pytest.raises(BadInput, match="not positive"):
        estimate(f"onnx:{tmp_path / 'n.onnx'}?size=8&range=1&meaning=depth")


def test_heuristic_is_loud_bounded_and_nearer_at_the_bottom(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        result = estimate("heuristic")
    assert "guessed" in caplog.text
    assert "guessed" in result.notes[0]
    assert result.source == "heuristic (no network)"
    assert not result.is_metric
    assert result.depth.shape == (H, W)
    assert result.depth.min() >= 1
    assert result.depth.max() <= 3
    assert result.depth[-1].mean() < result.depth[H // 2].mean()
    assert np.abs(np.diff(result.depth, axis=0)).max() < 0.6


def test_heuristic_survives_flat_and_tiny_images() -> None:
    for value in (0.0, 0.5, 1.0):
        depth = parse_depth_spec("heuristic").estimate(np.full((16, 16, 3), value, np.float32), CAMERA).depth
        assert np.isfinite(depth).all()


def test_sky_is_found_and_far() -> None:
    image = np.random.default_rng(0).random((120, 160, 3), dtype=np.float32) * 0.6
    image[:50] = (0.55, 0.7, 0.95)
    sky = sky_mask(image)
    assert sky[:45].mean() > 0.95
    assert not sky[55:].any()
    depth = parse_depth_spec("heuristic").estimate(image, CAMERA).depth
    np.testing.assert_allclose(depth[:40], 3.0, atol=0.05)
    image[:50] = (0.6, 0.4, 0.8)  # a purple wall
    assert not sky_mask(image).any()


def test_constant() -> None:
    np.testing.assert_array_equal(estimate("constant?z=2.5").depth, np.full((H, W), 2.5))


@pytest.mark.data
@pytest.mark.parametrize("scene", ["bear", "kitchen"])
def test_small_network_orders_real_scenes(data_root: Path, scene: str) -> None:
    image = to_float(load_image(data_root / f"realmdreamer/images/{scene}.png"))
    hfov = json.loads((data_root / "realmdreamer/scenes.json").read_text())[scene]["hfov_deg"]
    camera = Camera.from_fov(image.shape[1], image.shape[0], hfov)
    true = parse_depth_spec(f"file:{data_root}/realmdreamer/depth/{scene}.png?unit=0.0001").estimate(image, camera)
    network = data_root / "weights/tcmonodepth_small_384.onnx"
    guess = parse_depth_spec(f"onnx:{network}?size=384&range=255&meaning=inverse_depth").estimate(image, camera)
    assert spearmanr(guess.depth[::4, ::4].ravel(), true.depth[::4, ::4].ravel())[0] > 0.8
