"""MUSIQ: pyiqa's own scores from the same weights, on every kind of frame, and typed answers to bad input."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from numpy.typing import NDArray

from bench.metrics.group_norm import group_norm_
from bench.metrics.musiq import MUSIQ_KONIQ, Musiq
from orca.errors import BadInput, Unavailable
from tests.bench.learned_weights import as_tensor, given, musiq_metric, odd_frames
from tests.bench.small_cases import noise_image, smooth_image


@pytest.fixture(scope="module")
def reference() -> Any:
    return musiq_metric()


@pytest.fixture(scope="module")
def weights(reference: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("weights")
    torch.save({"params": reference.net.state_dict()}, folder / MUSIQ_KONIQ.name)
    return folder


@pytest.fixture(scope="module")
def musiq() -> Musiq:
    """One for all tests: it loads the network once."""
    return Musiq()


def pyiqa_scores(reference: Any, frames: NDArray[np.uint8]) -> list[float]:
    with torch.inference_mode():
        return [float(reference(as_tensor(frame))) for frame in frames]


def test_equals_pyiqa_on_every_kind_of_frame(reference: Any, weights: Path, musiq: Musiq) -> None:
    """Noise, grey, black, white, one colour, with cut patches at each scale: to a millionth of the score.

    Measured: two units in the last place of float32, 8e-6 on scores of about 60.
    """
    frames = odd_frames(70, 150)
    found = musiq.compute(given(frames, weights))["musiq"]
    expected = pyiqa_scores(reference, frames[1:])
    assert found.per_frame == pytest.approx([expected[0], *expected], rel=1e-6)
    assert found.value == pytest.approx(np.mean([expected[0], *expected]), rel=1e-6)
    assert (found.n, found.detail["distinct_frames"]) == (6, 5)
    assert np.ptp(expected) > 1  # the scores are apart by much more than the tolerance


@pytest.mark.parametrize(("height", "width"), [(300, 40), (1, 447)])
def test_equals_pyiqa_at_odd_sizes(reference: Any, weights: Path, musiq: Musiq, height: int, width: int) -> None:
    frames = noise_image(height, width)[None]
    found = musiq.compute(given(frames, weights))["musiq"]
    assert found.per_frame == pytest.approx(pyiqa_scores(reference, frames), rel=1e-6)


@pytest.mark.slow
def test_equals_pyiqa_on_full_frames(reference: Any, weights: Path, musiq: Musiq) -> None:
    from skimage import data

    frames = np.stack([data.astronaut(), smooth_image(512, 512)])
    found = musiq.compute(given(frames, weights))["musiq"]
    expected = pyiqa_scores(reference, frames)
    assert found.per_frame == pytest.approx(expected, rel=1e-6)
    assert abs(expected[0] - expected[1]) > 1


def test_a_frame_too_long_has_no_value(weights: Path, musiq: Musiq) -> None:
    found = musiq.compute(given(noise_image(1, 448)[None], weights))["musiq"]
    assert (found.value, found.n) == (None, 0)
    assert "448 times as long" in str(found.reason)


def test_no_frames_and_weights_of_nan_are_reasons(reference: Any, weights: Path, musiq: Musiq, tmp_path: Path) -> None:
    empty = musiq.compute(given(np.zeros((0, 64, 64, 3), np.uint8), weights))["musiq"]
    assert (empty.value, empty.reason) == (None, "no frames")
    state = {name: value.clone() for name, value in reference.net.state_dict().items()}
    state["embedding.bias"][0] = torch.nan
    torch.save(state, tmp_path / MUSIQ_KONIQ.name)
    broken = Musiq().compute(given(noise_image(40, 40)[None], tmp_path))["musiq"]
    assert (broken.value, broken.n) == (None, 0)
    assert "no finite score" in str(broken.reason)


@pytest.mark.parametrize(
    "frames",
    [
        np.full((1, 64, 64, 3), np.nan, np.float32),
        np.zeros((64, 64, 3), np.uint8),
        np.zeros((1, 64, 64), np.uint8),
        np.zeros((1, 64, 64, 4), np.uint8),
        np.zeros((1, 0, 64, 3), np.uint8),
    ],
)
def test_what_is_no_frames_is_bad_input(frames: np.ndarray[Any, Any], weights: Path, musiq: Musiq) -> None:
    with pytest.raises(BadInput, match="frames of shape"):
        musiq.compute(given(frames, weights))


def test_missing_weights_name_the_file_and_the_place(tmp_path: Path) -> None:
    with pytest.raises(Unavailable, match=r"musiq_koniq_ckpt-e95806b9\.pth") as caught:
        Musiq().compute(given(noise_image(64, 64)[None], tmp_path))
    assert str(tmp_path) in caught.value.given
    assert "--weights-dir" in caught.value.allowed
    assert "https://" in caught.value.fix
    with pytest.raises(Unavailable, match="no weights folder was given"):
        Musiq().compute(given(noise_image(64, 64)[None], None))


@pytest.mark.parametrize("content", ["garbage", "another network", "code"])
def test_weights_that_are_none_are_bad_input(content: str, tmp_path: Path) -> None:
    path = tmp_path / MUSIQ_KONIQ.name
    if content == "garbage":
        path.write_bytes(b"garbage")
    else:
        torch.save({"params": {"a": torch.zeros(3)}} if content == "another network" else Path("code"), path)
    with pytest.raises(BadInput, match="do not fit" if content == "another network" else "cannot be read"):
        Musiq().compute(given(noise_image(64, 64)[None], tmp_path))


def test_the_spec_follows_the_weights(tmp_path: Path) -> None:
    (spec,) = Musiq().specs(None)
    assert (spec.id, spec.higher_is_better, spec.weights_sha256) == ("musiq", True, None)
    for content in (b"one", b"another"):
        (tmp_path / MUSIQ_KONIQ.name).write_bytes(content)
        assert Musiq().specs(tmp_path)[0].weights_sha256 == hashlib.sha256(content).hexdigest()


@pytest.mark.parametrize(("side", "channels", "shift"), [(16, 64, 0.0), (8, 256, 3.0), (8, 64, -100.0)])
def test_group_norm_is_torchs(side: int, channels: int, shift: float) -> None:
    generator = torch.Generator().manual_seed(3)
    x = torch.randn(3, channels, side, side, generator=generator) + shift
    weight, bias = torch.randn(channels, generator=generator), torch.randn(channels, generator=generator)
    expected = F.group_norm(x.double(), 32, weight.double(), bias.double(), 1e-4)
    found = x.permute(0, 2, 3, 1).flatten(1, 2).contiguous().numpy()
    group_norm_(found, weight.numpy(), bias.numpy(), 1e-4, 32)
    back = torch.from_numpy(found).view(3, side, side, channels).permute(0, 3, 1, 2)
    assert torch.allclose(back.double(), expected, atol=2e-5 * max(1.0, abs(shift)))


def test_group_norm_of_a_constant_is_its_bias() -> None:
    x, bias = np.full((2, 64, 64), 7.25, np.float32), np.arange(64, dtype=np.float32)
    group_norm_(x, np.ones(64, np.float32), bias, 1e-4, 32)
    assert np.array_equal(x, np.broadcast_to(bias, x.shape))
