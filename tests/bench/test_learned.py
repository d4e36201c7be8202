"""Learned metrics: complete specs, and a typed, exact answer when their weights are missing or wrong."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

from bench.adapters.adapter import MethodOutput
from bench.metrics.learned import CLIP_RN50, LLAVA_QUESTIONS, MUSIQ_KONIQ, ClipIqa, Llava, Musiq
from bench.metrics.metric import MetricInput
from orca.errors import BadInput, Unavailable
from tests.bench.small_cases import make_case, noise_image, plane

CASE = make_case(noise_image(64, 96), plane(64, 96), [np.eye(4)])


def given(weights_dir: Path | None) -> MetricInput:
    frames = np.stack([noise_image(64, 96, 1), noise_image(64, 96, 1), noise_image(64, 96, 2)])
    return MetricInput(CASE, MethodOutput(frames), weights_dir)


@pytest.mark.parametrize(
    ("metric", "file"),
    [(Musiq(), MUSIQ_KONIQ.name), (ClipIqa(), "RN50.pt"), (Llava(), "llava-hf/bakLlava-v1-hf")],
)
def test_missing_weights_name_the_file_and_the_place(
    metric: Musiq | ClipIqa | Llava, file: str, tmp_path: Path
) -> None:
    with pytest.raises(Unavailable) as caught:
        metric.compute(given(tmp_path))
    assert file in caught.value.given
    assert str(tmp_path) in caught.value.given
    assert "--weights-dir" in caught.value.allowed
    assert "https://" in caught.value.fix
    with pytest.raises(Unavailable, match="no weights folder was given"):
        metric.compute(given(None))


def test_specs_are_complete_without_weights() -> None:
    specs = [*Musiq().specs(None), *ClipIqa().specs(None), *Llava().specs(None)]
    assert [s.id for s in specs] == ["musiq", "clipiqa", *(f"llava_{criterion}" for criterion in LLAVA_QUESTIONS)]
    for spec in specs:
        assert spec.higher_is_better
        assert spec.variant
        assert spec.version
        assert spec.weights_sha256 is None
    assert list(LLAVA_QUESTIONS) == ["noise_free", "edge", "structure", "detail", "quality"]
    assert LLAVA_QUESTIONS["quality"].endswith("good visual quailty")  # their spelling, word for word


def test_the_weights_hash_follows_the_file(tmp_path: Path) -> None:
    path = tmp_path / MUSIQ_KONIQ.name
    path.write_bytes(b"one")
    assert Musiq().specs(tmp_path)[0].weights_sha256 == hashlib.sha256(b"one").hexdigest()
    path.write_bytes(b"another")
    assert Musiq().specs(tmp_path)[0].weights_sha256 == hashlib.sha256(b"another").hexdigest()


def test_llava_with_the_model_present_says_it_is_not_built(tmp_path: Path) -> None:
    (tmp_path / "llava-hf/bakLlava-v1-hf").mkdir(parents=True)
    with pytest.raises(Unavailable, match="not built yet"):
        Llava().compute(given(tmp_path))


def test_another_file_named_rn50_is_never_run(tmp_path: Path) -> None:
    (tmp_path / CLIP_RN50.name).write_bytes(b"surprise")
    with pytest.raises(BadInput, match=hashlib.sha256(b"surprise").hexdigest()):
        ClipIqa().compute(given(tmp_path))


@pytest.mark.slow
def test_musiq_reads_weights_as_tensors_and_scores_each_distinct_frame(tmp_path: Path) -> None:
    """Seeded random weights stand in for the real ones: the path from file to score is what is tested."""
    import pyiqa
    import torch

    path = tmp_path / MUSIQ_KONIQ.name
    path.write_bytes(b"garbage")
    with pytest.raises(BadInput, match="cannot be read"):
        Musiq().compute(given(tmp_path))
    torch.manual_seed(0)
    network = pyiqa.create_metric("musiq", pretrained=False, device=torch.device("cpu"))
    torch.save({"params": network.net.state_dict()}, path)
    found = Musiq().compute(given(tmp_path))["musiq"]
    assert found.n == 3
    assert found.detail["distinct_frames"] == 2
    assert found.per_frame is not None
    assert found.per_frame[0] == found.per_frame[1] != found.per_frame[2]
    frame = torch.from_numpy(noise_image(64, 96, 2)).permute(2, 0, 1)[None].float() / 255
    with torch.no_grad():
        assert found.per_frame[2] == pytest.approx(float(network(frame)), rel=1e-5)
