"""Depth Pro and Depth Anything V2: the real classes, tiny, loaded from a weights folder and run."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from orca.camera import Camera
from orca.conventions import to_uint8
from orca.errors import BadInput, Unavailable, Unknown
from orca.priors.depth import DepthEstimate, clip_outliers, limit_far, parse_depth_spec
from orca.priors.hub import DEPTH_ANYTHING_V2_SMALL, DEPTH_PRO, ModelAccess
from orca.priors.learned import DepthAnythingDepth, DepthProDepth
from tests.orca.tiny_models import write_depth_anything, write_depth_pro

pytestmark = pytest.mark.slow  # importing the models' libraries takes longer than the tests

H, W = 40, 60
CAMERA = Camera.from_fov(W, H, 57)


def picture() -> np.ndarray:
    y, x = np.mgrid[0:H, 0:W]
    return np.stack([x / W, y / H, 0.5 + 0.5 * np.sin(x / 5)], 2).astype(np.float32)


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("weights")
    write_depth_pro(folder)
    write_depth_anything(folder)
    return folder


def estimate(name: str, weights: Path) -> DepthEstimate:
    return parse_depth_spec(name, ModelAccess(weights)).estimate(picture(), CAMERA)


def network_output(folder: Path) -> Any:
    """What the classes themselves say about the picture, without any code of ours."""
    import torch
    from transformers import AutoImageProcessor, AutoModelForDepthEstimation

    processor = AutoImageProcessor.from_pretrained(folder)
    network = AutoModelForDepthEstimation.from_pretrained(folder).eval()
    with torch.inference_mode():
        return processor, network(**processor(images=to_uint8(picture()), return_tensors="pt"))


def test_depth_pro_is_metric_and_knows_the_field_of_view(weights: Path) -> None:
    result = estimate("depth-pro", weights)
    processor, output = network_output(weights / DEPTH_PRO.repo)
    assert result.depth.shape == (H, W)
    assert result.is_metric
    assert result.source == "Depth Pro"
    assert result.hfov_deg == pytest.approx(float(output.field_of_view), rel=1e-5)
    focal = 0.5 * W / np.tan(0.5 * np.deg2rad(result.hfov_deg))
    canonical = cv2.resize(output.predicted_depth[0].numpy(), (W, H), interpolation=cv2.INTER_LINEAR)
    expected = 1 / np.clip(canonical * W / focal, 1e-4, 1e4)  # the paper's metric depth: f / (W C)
    inner = (expected > np.quantile(expected, 0.01)) & (expected < np.quantile(expected, 0.9))
    assert np.median(np.abs(result.depth - expected)[inner] / expected[inner]) < 1e-3
    assert result.depth.max() <= 50.01 * np.median(result.depth)
    assert processor.__class__.__name__.startswith("DepthPro")


def test_a_field_of_view_that_no_camera_has_is_replaced(weights: Path, tmp_path: Path) -> None:
    import torch
    from transformers import DepthProForDepthEstimation

    folder = tmp_path / DEPTH_PRO.repo
    shutil.copytree(weights / DEPTH_PRO.repo, folder)
    model = DepthProForDepthEstimation.from_pretrained(folder)
    with torch.no_grad():
        model.fov_model.head.layers[-1].bias.fill_(-400.0)
    model.save_pretrained(folder)
    result = estimate("depth-pro", tmp_path)
    assert result.hfov_deg == pytest.approx(57)
    assert any("not believed" in note for note in result.notes)
    assert np.ptp(result.depth) > 0


def test_depth_anything_is_relative_inverse_depth(weights: Path) -> None:
    result = estimate("depth-anything", weights)
    _, output = network_output(weights / DEPTH_ANYTHING_V2_SMALL.repo)
    inverse = cv2.resize(output.predicted_depth[0].numpy(), (W, H), interpolation=cv2.INTER_CUBIC)
    assert not result.is_metric
    assert result.hfov_deg is None
    assert np.median(result.depth) == pytest.approx(1)
    order = np.corrcoef(np.argsort(np.argsort(inverse.ravel())), np.argsort(np.argsort(-result.depth.ravel())))[0, 1]
    assert order > 0.95  # larger output is nearer


def test_metric_weights_of_depth_anything_are_taken_as_depth(tmp_path: Path) -> None:
    folder = write_depth_anything(tmp_path, "metric")
    result = estimate("depth-anything", tmp_path)
    _, output = network_output(folder)
    assert result.is_metric
    assert np.median(result.depth) == pytest.approx(float(output.predicted_depth.median()), rel=0.05)


def test_the_network_is_loaded_once(weights: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    provider = DepthAnythingDepth(ModelAccess(weights))
    first = provider.estimate(picture(), CAMERA).depth
    monkeypatch.setattr("orca.priors.learned._load", lambda *_: pytest.fail("loaded again"))
    np.testing.assert_array_equal(provider.estimate(picture(), CAMERA).depth, first)


@pytest.mark.parametrize("name", ["model.safetensors", "config.json", "preprocessor_config.json"])
def test_each_missing_file_is_named_with_its_place(weights: Path, tmp_path: Path, name: str) -> None:
    shutil.copytree(weights / DEPTH_PRO.repo, tmp_path / DEPTH_PRO.repo)
    (tmp_path / DEPTH_PRO.repo / name).unlink()
    with pytest.raises(Unavailable) as caught:
        estimate("depth-pro", tmp_path)
    assert name in caught.value.given
    assert str(tmp_path) in str(caught.value)
    assert "hf download apple/DepthPro-hf" in caught.value.fix


def test_a_pickle_is_not_read_in_place_of_safetensors(weights: Path, tmp_path: Path) -> None:
    folder = tmp_path / DEPTH_PRO.repo
    shutil.copytree(weights / DEPTH_PRO.repo, folder)
    (folder / "model.safetensors").rename(folder / "pytorch_model.bin")
    with pytest.raises(Unavailable, match=r"model\.safetensors"):
        DepthProDepth(ModelAccess(tmp_path)).load()


def test_broken_weights_are_bad_input(weights: Path, tmp_path: Path) -> None:
    folder = tmp_path / DEPTH_PRO.repo
    shutil.copytree(weights / DEPTH_PRO.repo, folder)
    (folder / "model.safetensors").write_bytes(b"no")
    with pytest.raises(BadInput, match="does not load"):
        estimate("depth-pro", tmp_path)


@pytest.mark.parametrize("broken", ["nan", "shape"])
def test_a_network_that_returns_no_map_is_refused(weights: Path, monkeypatch: pytest.MonkeyPatch, broken: str) -> None:
    import torch

    provider = DepthAnythingDepth(ModelAccess(weights))
    processor, network = provider.load()
    values = torch.full((H, W), float("nan")) if broken == "nan" else torch.ones(3, 3)

    class Processor:
        def __call__(self, **given: Any) -> Any:
            return processor(**given)

        def post_process_depth_estimation(self, *_: Any, **__: Any) -> list[dict[str, Any]]:
            return [{"predicted_depth": values}]

    monkeypatch.setattr(provider, "_loaded", (Processor(), network))
    with pytest.raises(BadInput, match="returned shape"):
        provider.estimate(picture(), CAMERA)


def test_there_are_no_options() -> None:
    with pytest.raises(Unknown, match="no option"):
        parse_depth_spec("depth-pro?size=3")


def test_outliers_are_clipped_at_their_quantiles() -> None:
    values = np.linspace(1, 2, 10_000, dtype=np.float32).reshape(100, 100)
    values[0, 0], values[0, 1], values[5, 5] = 1e6, -1e6, np.nan
    clipped = clip_outliers(values)
    assert np.nanmax(clipped) < 2.01
    assert np.nanmin(clipped) > 0.99
    assert np.isnan(clipped[5, 5])
    nothing = np.full((2, 2), np.nan, np.float32)
    assert np.isnan(clip_outliers(nothing)).all()


def test_far_is_bounded_and_said() -> None:
    depth = np.full((10, 10), 2.0, np.float32)
    assert limit_far(depth) == (depth, ())
    depth[:2] = 10_000
    bounded, notes = limit_far(depth)
    assert bounded.max() == 100
    assert notes[0].startswith("20.0% of the pixels")
