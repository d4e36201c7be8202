"""NIQE: equal to pyiqa's, a ladder of damage on a real image, frames without a value, and the missing prior."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.io import savemat

from bench.adapters.adapter import MethodOutput
from bench.metrics.metric import MetricInput, Score
from bench.metrics.niqe import NIQE_PRIOR, Niqe
from bench.metrics.per_frame import mean_over_frames
from orca.errors import BadInput, Unavailable
from tests.bench.small_cases import make_case, noise_image, plane

CASE = make_case(noise_image(4, 5), plane(4, 5), [np.eye(4)])


def compute(frames: NDArray[np.uint8], weights_dir: Path | None) -> Score:
    return Niqe().compute(MetricInput(CASE, MethodOutput(frames), weights_dir))["niqe"]


def test_a_missing_prior_names_the_file_and_the_place(tmp_path: Path) -> None:
    with pytest.raises(Unavailable, match=r"niqe_modelparameters\.mat") as caught:
        compute(CASE.image[None], tmp_path)
    assert str(tmp_path) in caught.value.given
    assert "--weights-dir" in caught.value.allowed
    with pytest.raises(Unavailable, match="no weights folder was given"):
        compute(CASE.image[None], None)


def test_specs_import_neither_pyiqa_nor_torch() -> None:
    code = (
        "import sys; from bench.metrics import METRICS;"
        "[METRICS.get(m)().specs(None) for m in ('niqe','musiq','clipiqa','llava_edge','psnr','visible_psnr')];"
        "print([m for m in ('pyiqa', 'torch', 'skimage') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_equal_frames_are_scored_once_and_the_mean_is_over_values() -> None:
    calls: list[int] = []

    def brightness(frame: NDArray[np.uint8]) -> float | None:
        calls.append(1)
        return None if frame.max() == 0 else float(frame.max())

    frames = np.zeros((5, 2, 2, 3), np.uint8)
    frames[1], frames[2], frames[3] = 10, 10, 40
    found = mean_over_frames(frames, brightness, "black")
    assert found.value == pytest.approx(20.0)
    assert found.n == 3
    assert found.per_frame == (None, 10.0, 10.0, 40.0, None)
    assert len(calls) == found.detail["distinct_frames"] == 3
    assert found.detail["frames_without_value"] == 2


def test_no_frames_no_values_and_nan_are_reasons() -> None:
    empty = mean_over_frames(np.zeros((0, 2, 2, 3), np.uint8), lambda frame: 1.0, "why")
    assert (empty.value, empty.reason) == (None, "no frames")
    broken = mean_over_frames(np.zeros((1, 2, 2, 3), np.uint8), lambda frame: float("nan"), "why")
    assert (broken.value, broken.reason, broken.n) == (None, "why", 0)


@pytest.mark.parametrize("content", [b"", b"not a matlab file" * 100])
def test_a_broken_prior_is_bad_input(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "niqe_modelparameters.mat").write_bytes(content)
    with pytest.raises(BadInput, match="cannot be read"):
        compute(CASE.image[None], tmp_path)


def test_a_prior_of_another_size_is_bad_input(tmp_path: Path) -> None:
    savemat(tmp_path / "niqe_modelparameters.mat", {"mu_prisparam": np.zeros(5), "cov_prisparam": np.eye(5)})
    with pytest.raises(BadInput, match=r"mean \(5,\)"):
        compute(CASE.image[None], tmp_path)


def write_prior(folder: Path) -> None:
    """A prior of the right form with made-up numbers: enough to compare two implementations without real weights."""
    rng = np.random.default_rng(5)
    root = rng.normal(size=(36, 36))
    content = {"mu_prisparam": rng.uniform(0, 3, 36)[None], "cov_prisparam": root @ root.T / 36 + np.eye(36)}
    savemat(folder / "niqe_modelparameters.mat", content)


@pytest.fixture
def made_up_prior(tmp_path: Path) -> Path:
    write_prior(tmp_path)
    return tmp_path


@pytest.mark.filterwarnings("error")
def test_frames_without_a_value(made_up_prior: Path) -> None:
    flat = compute(np.full((2, 200, 200, 3), 128, np.uint8), made_up_prior)
    black = compute(np.zeros((1, 200, 200, 3), np.uint8), made_up_prior)
    for found in (flat, black):
        assert found.value is None
        assert "flat, or fewer than two whole blocks" in str(found.reason)
    small = compute(np.stack([noise_image(95, 400), noise_image(95, 400, 1)]), made_up_prior)
    assert "fewer than two whole blocks" in str(small.reason)
    assert compute(noise_image(96, 192)[None], made_up_prior).value is not None


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:cov")
def test_equals_pyiqa(made_up_prior: Path) -> None:
    """The fast path against the reference, on whole, damaged, cropped, saturated and partly black real photographs."""
    import pyiqa
    import torch
    from skimage import data

    reference = pyiqa.create_metric(
        "niqe", pretrained_model_path=str(made_up_prior / NIQE_PRIOR.name), device=torch.device("cpu")
    )
    image = data.astronaut()[:300, :420]
    noise = np.random.default_rng(0).normal(0, 25, image.shape)
    holes, mostly_black = image.copy(), np.zeros_like(image)
    holes[60:200, :250] = 0
    mostly_black[:150, :200] = image[:150, :200]
    ladder = [
        image,
        cv2.GaussianBlur(image, (0, 0), 3),
        np.clip(image + noise, 0, 255).astype(np.uint8),
        np.clip(image.astype(np.int64) * 3 - 200, 0, 255).astype(np.uint8),
        holes,
        mostly_black,
    ]
    found = compute(np.stack(ladder), made_up_prior)
    batch = torch.from_numpy(np.stack(ladder)).permute(0, 3, 1, 2).float() / 255
    expected = [float(reference(frame[None])) for frame in batch]
    assert found.per_frame == pytest.approx(expected, rel=3e-5)  # 1.2e-5 seen, on one kind of CPU
    assert len(set(expected)) == len(ladder)


@pytest.mark.data
def test_ladder_on_a_real_image(data_root: Path) -> None:
    """The kitchen scores 2.21; more blur, and more noise, score worse each step."""
    weights = data_root / "weights"
    image = cv2.imread(str(data_root / "realmdreamer/images/kitchen.png"))[..., ::-1]
    noise = np.random.default_rng(0).normal(size=image.shape)
    frames = [image, *(cv2.GaussianBlur(image, (0, 0), s) for s in (1.0, 2.0, 4.0))]
    frames += [np.clip(image + s * noise, 0, 255).astype(np.uint8) for s in (10.0, 20.0, 40.0)]
    found = compute(np.stack(frames), weights)
    values = [x for x in found.per_frame or () if x is not None]
    assert values[0] == pytest.approx(2.2145, abs=5e-4)
    assert values[0] < values[1] < values[2] < values[3]
    assert values[0] < values[4] < values[5] < values[6]
    assert found.n == 7
    digest = Niqe().specs(weights)[0].weights_sha256
    assert digest is not None
    assert len(digest) == 64
