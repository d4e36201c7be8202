"""CLIP-IQA: pyiqa's own scores from the same weights, open_clip's from them too, text once, typed answers."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from bench.metrics import clip_iqa
from bench.metrics.clip_iqa import CLIP_RN50, ClipIqa, ClipIqaOpenClip
from bench.metrics.clip_iqa_network import open_clip_pairs, pyiqa_pairs, read_clip_state
from bench.metrics.clip_prompts import FIVE_PAIRS, PROMPT_PAIRS
from orca.errors import BadInput, Unavailable
from tests.bench.learned_weights import as_tensor, clip_state, given, odd_frames
from tests.bench.small_cases import noise_image, smooth_image

State = dict[str, torch.Tensor]

# torch retires the format of the published file; it is still the one to be read
pytestmark = pytest.mark.filterwarnings("ignore:`torch.jit:FutureWarning")


@pytest.fixture(scope="module")
def state() -> State:
    return clip_state()


@pytest.fixture
def weights(state: State, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with an archive in OpenAI's form, pinned in place of the published one."""
    save_archive(state, tmp_path / CLIP_RN50.name)
    digest = hashlib.sha256((tmp_path / CLIP_RN50.name).read_bytes()).hexdigest()
    pinned = clip_iqa.WeightsFile(CLIP_RN50.metric, CLIP_RN50.name, CLIP_RN50.source, digest)
    monkeypatch.setattr(clip_iqa, "CLIP_RN50", pinned)
    return tmp_path


def save_archive(state: State, path: Path) -> None:
    """A TorchScript module that holds a state dict, as the published file does."""
    root = torch.nn.Module()
    for name, value in state.items():
        *parents, leaf = name.split(".")
        module = root
        for parent in parents:
            if not hasattr(module, parent):
                module.add_module(parent, torch.nn.Module())
            module = getattr(module, parent)
        module.register_buffer(leaf, value.clone())
    torch.jit.save(torch.jit.script(root), str(path))


def pyiqa_scores(state: State, frames: NDArray[np.uint8], monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """What pyiqa's own metric says, with these weights in place of those it would download."""
    import pyiqa
    from pyiqa.archs import clipiqa_arch
    from pyiqa.archs.clip_model import build_model

    monkeypatch.setattr(clipiqa_arch, "load", lambda name, device: build_model(dict(state)).float())
    metric = pyiqa.create_metric("clipiqa", device=torch.device("cpu"))
    with torch.inference_mode():
        return [float(metric(as_tensor(frame))) for frame in frames]


def test_both_routes_equal_pyiqa_on_every_kind_of_frame(
    state: State, weights: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Noise, grey, black, white, one colour, neither side a multiple of 32: 1e-5 through pyiqa, 1e-3 by open_clip."""
    frames = odd_frames(70, 101)
    expected = pyiqa_scores(state, frames, monkeypatch)
    ours = ClipIqa().compute(given(frames, weights))["clipiqa"]
    assert ours.per_frame == pytest.approx(expected, abs=1e-5)
    assert ours.value == pytest.approx(np.mean(expected), abs=1e-5)
    assert (ours.n, ours.detail["distinct_frames"]) == (6, 5)
    other = ClipIqaOpenClip().compute(given(frames, weights))
    assert other["clipiqa_openclip"].per_frame == pytest.approx(expected, abs=1e-3)
    assert other["clipiqa_photo"].per_frame != other["clipiqa_openclip"].per_frame
    assert np.ptp(expected) > 0.02  # the scores are apart by much more than the tolerances


@pytest.mark.slow
def test_the_routes_agree_at_the_real_networks_size(monkeypatch: pytest.MonkeyPatch) -> None:
    """Random weights in the shape of RN50's image half, on a frame of 224x224 and one of another size."""
    state = clip_state(seed=2, width=64, layers=(3, 4, 6, 3))
    one, two, scores = pyiqa_pairs(state, "cpu"), open_clip_pairs(state, "cpu"), []
    for frame in (smooth_image(224, 224), noise_image(160, 256)):
        expected = pyiqa_scores(state, frame[None], monkeypatch)[0]
        found = one(frame)
        assert found[FIVE_PAIRS].mean() == pytest.approx(expected, abs=1e-5)
        assert two(frame) == pytest.approx(found, abs=1e-3)
        scores.append(expected)
    assert abs(scores[0] - scores[1]) > 0.005


def test_both_libraries_read_the_prompts_alike() -> None:
    import open_clip
    from pyiqa.archs.clip_imports import clip

    texts = [text for pair in PROMPT_PAIRS for text in pair]
    assert torch.equal(clip.tokenize(texts).long(), open_clip.tokenize(texts).long())


def test_the_five_pairs_are_pyiqas(monkeypatch: pytest.MonkeyPatch, state: State) -> None:
    """Their words are read from pyiqa's own metric, so a change there is seen here."""
    from pyiqa.archs import clipiqa_arch
    from pyiqa.archs.clip_imports import clip
    from pyiqa.archs.clip_model import build_model

    monkeypatch.setattr(clipiqa_arch, "load", lambda name, device: build_model(dict(state)).float())
    theirs = clipiqa_arch.CLIPIQA().prompt_pairs
    assert torch.equal(theirs, clip.tokenize([text for pair in PROMPT_PAIRS[FIVE_PAIRS] for text in pair]))


def test_texts_are_encoded_once(state: State) -> None:
    calls: list[int] = []

    def encode_text(tokens: torch.Tensor) -> torch.Tensor:
        calls.append(len(tokens))
        return torch.eye(12, 16)

    from bench.metrics.clip_iqa_network import ClipPairs

    def encode_image(image: torch.Tensor) -> torch.Tensor:
        return torch.cat([torch.full((1, 1), 3.0), torch.full((1, 1), -4.0), torch.zeros(1, 14)], dim=1)

    pairs = ClipPairs(encode_image, encode_text, torch.zeros(12, 77, dtype=torch.int), torch.zeros(()), "cpu")
    found = [pairs(noise_image(32, 32, k)) for k in range(3)]
    assert calls == [12]
    by_hand = np.exp(3 / 5) / (np.exp(3 / 5) + np.exp(-4 / 5))  # cosines of the first pair: 0.6 and -0.8
    assert found[2] == pytest.approx([by_hand, 0.5, 0.5, 0.5, 0.5, 0.5], abs=1e-6)


def test_small_frames_no_frames_and_weights_of_nan_are_reasons(state: State, weights: Path, tmp_path: Path) -> None:
    metric = ClipIqa()
    small = metric.compute(given(noise_image(31, 64)[None], weights))["clipiqa"]
    assert (small.value, small.n) == (None, 0)
    assert "below 32 pixels" in str(small.reason)
    assert metric.compute(given(noise_image(32, 32)[None], weights))["clipiqa"].value is not None
    for score in ClipIqaOpenClip().compute(given(np.zeros((0, 64, 64, 3), np.uint8), weights)).values():
        assert (score.value, score.reason) == (None, "no frames")


def test_weights_of_nan_give_no_value(state: State, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    broken = {**state, "visual.bn1.bias": torch.full_like(state["visual.bn1.bias"], torch.nan)}
    save_archive(broken, tmp_path / CLIP_RN50.name)
    monkeypatch.setattr(clip_iqa, "CLIP_RN50", clip_iqa.WeightsFile("clipiqa", CLIP_RN50.name, "https://x"))
    found = ClipIqa().compute(given(noise_image(32, 32)[None], tmp_path))["clipiqa"]
    assert (found.value, found.n) == (None, 0)
    assert "no finite score" in str(found.reason)


@pytest.mark.parametrize("metric", [ClipIqa(), ClipIqaOpenClip()])
def test_wrong_frames_wrong_files_and_missing_ones(metric: ClipIqa | ClipIqaOpenClip, tmp_path: Path) -> None:
    frames: NDArray[Any] = noise_image(64, 64)[None]
    with pytest.raises(Unavailable, match=r"RN50\.pt") as caught:
        metric.compute(given(frames, tmp_path))
    assert str(tmp_path) in caught.value.given
    assert "https://" in caught.value.fix
    with pytest.raises(Unavailable, match="no weights folder was given"):
        metric.compute(given(frames, None))
    (tmp_path / CLIP_RN50.name).write_bytes(b"surprise")  # never run: a TorchScript archive holds code
    with pytest.raises(BadInput, match=hashlib.sha256(b"surprise").hexdigest()):
        metric.compute(given(frames, tmp_path))
    for wrong in (frames[0], frames.astype(np.float32) * np.nan, frames[..., :1]):
        with pytest.raises(BadInput, match="frames of shape"):
            metric.compute(given(wrong, tmp_path))


def test_an_archive_of_something_else_is_bad_input(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "garbage").write_bytes(b"garbage")
    with pytest.raises(BadInput, match="cannot be read"):
        read_clip_state(tmp_path / "garbage")
    save_archive({"a.b": torch.zeros(2)}, tmp_path / CLIP_RN50.name)
    monkeypatch.setattr(clip_iqa, "CLIP_RN50", clip_iqa.WeightsFile("clipiqa", CLIP_RN50.name, "https://x"))
    for metric in (ClipIqa(), ClipIqaOpenClip()):
        with pytest.raises(BadInput, match="is not CLIP RN50"):
            metric.compute(given(noise_image(64, 64)[None], tmp_path))


def test_specs_say_route_prompts_and_weights(weights: Path) -> None:
    specs = [*ClipIqa().specs(weights), *ClipIqaOpenClip().specs(weights)]
    assert [s.id for s in specs] == ["clipiqa", "clipiqa_openclip", "clipiqa_photo"]
    assert specs[0].version.startswith("pyiqa ")
    assert specs[1].version.startswith("open_clip ")
    assert "'Good photo.'" in specs[2].variant
    for spec in specs:
        assert spec.higher_is_better
        assert spec.weights_sha256 == hashlib.sha256((weights / "RN50.pt").read_bytes()).hexdigest()
    assert ClipIqa().specs(None)[0].weights_sha256 is None
