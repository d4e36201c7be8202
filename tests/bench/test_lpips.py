"""LPIPS: equal to an independent forward on seeded random weights, ladders, the mask, and files missing or broken."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from bench.adapters.adapter import MethodOutput
from bench.datasets.case import TrueView
from bench.metrics.fidelity import resize_to
from bench.metrics.lpips import LPIPS_ALEX, LPIPS_VGG, Lpips, LpipsVgg, LpipsWeights
from bench.metrics.metric import MetricInput, Score
from orca.errors import BadInput, Unavailable
from tests.bench.small_cases import camera_of, make_case, noise_image, plane, smooth_image

H, W = 64, 80
Image = NDArray[np.uint8]
# Convolutions of the trunks as (place in torchvision's list, in, out, kernel, stride, padding), "tap" after a ReLU
# whose output is compared, "pool" as (kernel, stride).
ALEX: list[Any] = [
    (0, 3, 64, 11, 4, 2), "tap", (3, 2), (3, 64, 192, 5, 1, 2), "tap", (3, 2), (6, 192, 384, 3, 1, 1), "tap",
    (8, 384, 256, 3, 1, 1), "tap", (10, 256, 256, 3, 1, 1), "tap",
]  # fmt: skip
VGG: list[Any] = [
    (0, 3, 64, 3, 1, 1), (2, 64, 64, 3, 1, 1), "tap", (2, 2), (5, 64, 128, 3, 1, 1), (7, 128, 128, 3, 1, 1), "tap",
    (2, 2), (10, 128, 256, 3, 1, 1), (12, 256, 256, 3, 1, 1), (14, 256, 256, 3, 1, 1), "tap", (2, 2),
    (17, 256, 512, 3, 1, 1), (19, 512, 512, 3, 1, 1), (21, 512, 512, 3, 1, 1), "tap", (2, 2),
    (24, 512, 512, 3, 1, 1), (26, 512, 512, 3, 1, 1), (28, 512, 512, 3, 1, 1), "tap",
]  # fmt: skip
TRUNKS = {"alex": ALEX, "vgg": VGG}


def write_weights(folder: Path, weights: LpipsWeights) -> dict[str, Any]:
    """Seeded random weights in both files' published layouts; returns all tensors."""
    import torch

    generator = torch.Generator().manual_seed(3)
    trunk, heads, channels, width = {}, {}, [], 0
    for layer in TRUNKS[weights.net]:
        if layer == "tap":
            k = len(channels)
            heads[f"lin{k}.model.1.weight"] = torch.rand(1, width, 1, 1, generator=generator) / width
            channels.append(width)
        elif len(layer) == 6:
            place, inputs, width, kernel, _, _ = layer
            scale = (2.0 / (inputs * kernel * kernel)) ** 0.5
            trunk[f"features.{place}.weight"] = scale * torch.randn(width, inputs, kernel, kernel, generator=generator)
            trunk[f"features.{place}.bias"] = 0.05 * torch.randn(width, generator=generator)
    trunk["classifier.1.weight"] = torch.zeros(2, 2)  # the published file goes on; what is not needed is not read
    torch.save(trunk, folder / weights.trunk.name)
    torch.save(heads, folder / weights.heads.name)
    return {**trunk, **heads}


def independent_map(net: str, tensors: dict[str, Any], a: Image, b: Image) -> NDArray[np.float64]:
    """LPIPS written out in double precision: [layers, H, W], each layer's distance brought to the image's size."""
    import torch
    import torch.nn.functional as F

    shift, scale = torch.tensor([-0.030, -0.088, -0.188]), torch.tensor([0.458, 0.448, 0.450])

    def taps(image: Image) -> list[Any]:
        x = torch.from_numpy(image.astype(np.float64) / 127.5 - 1.0)  # [-1, 1]
        x = ((x - shift.double()) / scale.double()).permute(2, 0, 1)[None]
        found = []
        for layer in TRUNKS[net]:
            if layer == "tap":
                found.append(x / (x.pow(2).sum(1, keepdim=True).sqrt() + 1e-10))
            elif len(layer) == 2:
                x = F.max_pool2d(x, *layer)
            else:
                place, _, _, _, stride, padding = layer
                weight, bias = (tensors[f"features.{place}.{part}"].double() for part in ("weight", "bias"))
                x = F.relu(F.conv2d(x, weight, bias, stride, padding))
        return found

    maps = []
    for k, (p, q) in enumerate(zip(taps(a), taps(b), strict=True)):
        distance = ((p - q) ** 2 * tensors[f"lin{k}.model.1.weight"].double()).sum(1, keepdim=True)
        maps.append((distance.mean(), F.interpolate(distance, a.shape[:2], mode="bilinear", align_corners=False)))
    whole = float(sum(mean for mean, _ in maps))
    return np.stack([np.full(a.shape[:2], whole), sum(here for _, here in maps)[0, 0].numpy()])


def compute(metric: Lpips, folder: Path | None, image: Image, render: Image, hidden: Any = None) -> dict[str, Score]:
    mask = np.zeros(image.shape[:2], np.bool_) if hidden is None else hidden
    view = TrueView(camera_of(*image.shape[:2]), image, mask)
    case = make_case(image, plane(*image.shape[:2]), [np.eye(4)], (view,))
    return metric.compute(MetricInput(case, MethodOutput(image[None], true_views=(render,)), folder))


@pytest.fixture(scope="module")
def alex(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("alex")
    return folder, write_weights(folder, LPIPS_ALEX)


def half() -> NDArray[np.bool_]:
    mask = np.zeros((H, W), np.bool_)
    mask[10:40, 50:] = True
    return mask


def test_equals_an_independent_forward(alex: tuple[Path, dict[str, Any]]) -> None:
    folder, tensors = alex
    image, render = smooth_image(H, W), noise_image(H, W)
    found = compute(Lpips(), folder, image, render, half())
    whole, here = independent_map("alex", tensors, render, image)
    assert found["lpips"].value == pytest.approx(whole[0, 0], rel=1e-4)
    assert found["hole_lpips"].value == pytest.approx(here[half()].mean(), rel=1e-4)
    assert found["lpips"].value > 0.01  # type: ignore[operator]
    assert found["lpips"].value != pytest.approx(found["hole_lpips"].value, rel=1e-2)


@pytest.mark.slow
def test_vgg_equals_an_independent_forward(tmp_path: Path) -> None:
    tensors = write_weights(tmp_path, LPIPS_VGG)
    image, render = smooth_image(H, W), noise_image(H, W)
    found = compute(LpipsVgg(), tmp_path, image, render, half())
    whole, here = independent_map("vgg", tensors, render, image)
    assert found["lpips_vgg"].value == pytest.approx(whole[0, 0], rel=1e-4)
    assert found["hole_lpips_vgg"].value == pytest.approx(here[half()].mean(), rel=1e-4)


def test_more_blur_noise_and_holes_are_farther(alex: tuple[Path, dict[str, Any]]) -> None:
    metric = Lpips()
    image = cv2.resize(noise_image(16, 20), (W, H), interpolation=cv2.INTER_CUBIC)
    noise, where = np.random.default_rng(0).normal(size=image.shape), np.random.default_rng(1).random((H, W))
    ladders = {
        "blur": [cv2.GaussianBlur(image, (0, 0), s) for s in (1.0, 2.0, 4.0)],
        "noise": [np.clip(image + s * noise, 0, 255).astype(np.uint8) for s in (8, 24, 72)],
        "holes": [np.where((where < s)[..., None], np.uint8(0), image) for s in (0.02, 0.1, 0.4)],
    }
    assert compute(metric, alex[0], image, image)["lpips"].value == 0.0
    for name, ladder in ladders.items():
        found = [compute(metric, alex[0], image, render)["lpips"].value for render in ladder]
        assert 0 < found[0] < found[1] < found[2], name  # type: ignore[operator]


def test_damage_outside_the_mask_is_felt_by_the_whole_only(alex: tuple[Path, dict[str, Any]]) -> None:
    image = noise_image(160, 160)
    hidden = np.zeros((160, 160), np.bool_)
    hidden[:24, :24] = True
    render = image.copy()
    render[136:, 136:] = 0
    found = compute(Lpips(), alex[0], image, render, hidden)
    assert found["lpips"].value > 1e-5  # type: ignore[operator]
    assert found["hole_lpips"].value < 0.01 * found["lpips"].value  # type: ignore[operator]


@pytest.mark.parametrize("level", [0, 128, 255])
def test_grey_and_constant_pictures(alex: tuple[Path, dict[str, Any]], level: int) -> None:
    """No structure divides by nothing: equal greys are 0 apart, a grey from a picture what the formula says."""
    grey = np.full((H, W, 3), level, np.uint8)
    assert compute(Lpips(), alex[0], grey, grey)["lpips"].value == 0.0
    image = smooth_image(H, W)
    found = compute(Lpips(), alex[0], image, grey, half())
    whole, here = independent_map("alex", alex[1], grey, image)
    assert found["lpips"].value == pytest.approx(whole[0, 0], rel=1e-4)
    assert found["hole_lpips"].value == pytest.approx(here[half()].mean(), rel=1e-4)


def test_a_picture_of_another_size_is_brought_to_that_of_the_truth(alex: tuple[Path, dict[str, Any]]) -> None:
    """By the rule that the spec states, before anything is compared: the score is that of the resized picture."""
    image = smooth_image(H, W)
    for size in ((W - 1, H), (W // 2, H // 2), (2 * W, 3 * H)):
        other = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        found = compute(Lpips(), alex[0], image, other)["lpips"].value
        same = compute(Lpips(), alex[0], image, resize_to(other, W, H))["lpips"].value
        assert found == same
        assert found < 0.5 * compute(Lpips(), alex[0], image, noise_image(H, W))["lpips"].value  # type: ignore[operator]


def test_reasons(alex: tuple[Path, dict[str, Any]]) -> None:
    image = noise_image(H, W)
    assert compute(Lpips(), alex[0], image, image)["hole_lpips"].reason == "nothing is hidden in the true view"
    tiny = compute(Lpips(), alex[0], image[:20], image[:20], half()[:20])
    assert {score.reason for score in tiny.values()} == {"the true view is smaller than 32x32 pixels"}
    no_view = make_case(image, plane(H, W), [np.eye(4)])
    found = Lpips().compute(MetricInput(no_view, MethodOutput(image[None])))
    assert {score.reason for score in found.values()} == {"no true view in this data set"}


@pytest.mark.parametrize("metric", [Lpips(), LpipsVgg()])
def test_missing_weights_name_the_file(metric: Lpips, tmp_path: Path) -> None:
    image = noise_image(H, W)
    with pytest.raises(Unavailable, match=r"alexnet-owt|vgg16-"):
        compute(metric, tmp_path, image, image)
    (tmp_path / metric.weights.trunk.name).write_bytes(b"x")
    with pytest.raises(Unavailable, match=r"LPIPS_v0\.1"):
        compute(metric, tmp_path, image, image)
    assert metric.specs(tmp_path)[0].weights_sha256 is None


def test_broken_and_foreign_files_are_bad_input(alex: tuple[Path, dict[str, Any]], tmp_path: Path) -> None:
    import torch

    image = noise_image(H, W)
    (tmp_path / LPIPS_ALEX.trunk.name).write_bytes(b"garbage")
    (tmp_path / LPIPS_ALEX.heads.name).write_bytes((alex[0] / LPIPS_ALEX.heads.name).read_bytes())
    with pytest.raises(BadInput, match="cannot be read"):
        compute(Lpips(), tmp_path, image, image)
    torch.save({"features.0.weight": torch.zeros(3)}, tmp_path / LPIPS_ALEX.trunk.name)
    with pytest.raises(BadInput, match=r"features\.0\.weight of shape \[64, 3, 11, 11\]"):
        compute(Lpips(), tmp_path, image, image)
    (tmp_path / LPIPS_ALEX.trunk.name).write_bytes((alex[0] / LPIPS_ALEX.trunk.name).read_bytes())
    torch.save({"lin0.model.1.weight": torch.zeros(1, 64, 1, 1)}, tmp_path / LPIPS_ALEX.heads.name)
    with pytest.raises(BadInput, match=r"lin1\.model\.1\.weight"):
        compute(Lpips(), tmp_path, image, image)


def test_specs_carry_both_hashes_and_import_nothing_heavy(alex: tuple[Path, dict[str, Any]]) -> None:
    spec = Lpips().specs(alex[0])[0]
    assert spec.weights_sha256 is not None
    assert len(spec.weights_sha256) == 2 * 64 + 1
    code = (
        "import sys; from bench.metrics.lpips import Lpips, LpipsVgg; Lpips().specs(None); LpipsVgg().specs(None);"
        "print([m for m in ('pyiqa', 'torch', 'torchvision', 'skimage') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_pyiqa_is_left_as_it_was(alex: tuple[Path, dict[str, Any]]) -> None:
    from pyiqa.archs import lpips_arch
    from torchvision import models

    image = noise_image(H, W)
    compute(Lpips(), alex[0], image, image)
    assert lpips_arch.models is models
