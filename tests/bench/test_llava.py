"""LLaVA-IQA on this machine: prompt and parser word for word, the real generate path, answers that survive."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from bench.metrics.llava import BAKLLAVA, Llava
from bench.metrics.llava_answers import Answers, Question
from bench.metrics.llava_local import LocalLlava
from bench.metrics.llava_prompt import LLAVA_QUESTIONS, full_prompt, said_yes
from bench.metrics.metric import MetricOptions
from orca.errors import BadInput, Unavailable
from tests.bench.learned_weights import given
from tests.bench.small_cases import noise_image

WORDS = ["USER", ":", "ASSISTANT", ",", "?", "just", "anwser", "with", "yes", "or", "no", "Is", "the", "image", "free"]


def save_tiny_llava(folder: Path, says: str | None = None) -> None:
    """A LLaVA of random weights with the real classes and a tokenizer of a few words.

    With ``says`` its last norm is zero, so that all words are as likely and greedy search takes the first: that one.
    """
    from tokenizers import Tokenizer
    from tokenizers.models import WordLevel
    from tokenizers.pre_tokenizers import Whitespace
    from transformers import (
        CLIPImageProcessor,
        CLIPVisionConfig,
        LlavaConfig,
        LlavaForConditionalGeneration,
        LlavaProcessor,
        MistralConfig,
        PreTrainedTokenizerFast,
    )

    words = list(
        dict.fromkeys(
            [says or "Yes", "<unk>", "<s>", "</s>", "<pad>", "<image>", *WORDS, *(f"w{k}" for k in range(200))]
        )
    )
    tokenizer = Tokenizer(WordLevel({word: k for k, word in enumerate(words)}, unk_token="<unk>"))
    tokenizer.pre_tokenizer = Whitespace()
    special = {"unk_token": "<unk>", "bos_token": "<s>", "eos_token": "</s>", "pad_token": "<pad>"}
    fast = PreTrainedTokenizerFast(tokenizer_object=tokenizer, additional_special_tokens=["<image>"], **special)
    images = CLIPImageProcessor(size={"shortest_edge": 28}, crop_size={"height": 28, "width": 28})
    processor = LlavaProcessor(
        images, fast, patch_size=14, vision_feature_select_strategy="default", num_additional_image_tokens=1
    )
    small: dict[str, Any] = {
        "hidden_size": 32,
        "intermediate_size": 48,
        "num_hidden_layers": 2,
        "initializer_range": 0.3,
    }
    heads: dict[str, Any] = {"num_attention_heads": 4}
    vision = CLIPVisionConfig(**small, **heads, image_size=28, patch_size=14, projection_dim=32)
    ids = {
        "bos_token_id": words.index("<s>"),
        "eos_token_id": words.index("</s>"),
        "pad_token_id": words.index("<pad>"),
    }
    text = MistralConfig(**small, **heads, num_key_value_heads=2, vocab_size=len(words), **ids)
    torch.manual_seed(0)
    model = LlavaForConditionalGeneration(
        LlavaConfig(vision_config=vision, text_config=text, image_token_id=words.index("<image>"))
    )
    if says is not None:
        torch.nn.init.zeros_(model.model.language_model.norm.weight)
    model.half().save_pretrained(folder)
    processor.save_pretrained(folder)


def as_vistadream_asks(folder: Path, frame: np.ndarray[Any, Any], question: str) -> str:
    """Their procedure, written out: the whole output is decoded, and what follows the prompt is the answer."""
    from PIL import Image
    from transformers import AutoProcessor, LlavaForConditionalGeneration

    processor = AutoProcessor.from_pretrained(folder)
    model = LlavaForConditionalGeneration.from_pretrained(folder, dtype=torch.float16)
    prompt = f"<image>\n USER: {question}, just anwser with yes or no? \n ASSISTANT: "
    inputs = processor(images=Image.fromarray(frame), text=prompt, return_tensors="pt").to("cpu", torch.float16)
    tokens = model.generate(**inputs, max_new_tokens=200, do_sample=False)
    text: str = processor.decode(tokens[0], skip_special_tokens=True)
    return text.partition("ASSISTANT :")[2].lstrip()


def test_questions_and_prompt_are_vistadreams_word_for_word() -> None:
    assert list(LLAVA_QUESTIONS) == ["noise_free", "edge", "structure", "detail", "quality"]
    assert LLAVA_QUESTIONS["quality"].endswith("good visual quailty")  # their spelling
    assert full_prompt(LLAVA_QUESTIONS["noise_free"]) == (
        "<image>\n USER: Is the image free of noise or distortion, just anwser with yes or no? \n ASSISTANT: "
    )


@pytest.mark.parametrize(
    ("answer", "yes"),
    [
        ("Yes", True),
        ("  yes, it is", True),
        ("YES.", True),
        ("no", False),
        ("No, the image is noisy", False),
        (" \n NO!", False),
        ("USER: yes? ASSISTANT: no", False),
        ("no ASSISTANT:  Yes", True),
        ("not sure", None),
        ("Nothing", None),
        ("The answer is yes", None),
        ("", None),
        ("ASSISTANT:", None),
        ("\x00 ja", None),
    ],
)
def test_answers_are_read_as_vistadream_reads_them(answer: str, yes: bool | None) -> None:
    assert said_yes(answer) is yes


@pytest.mark.slow
def test_the_local_model_answers_as_vistadreams_program_would(tmp_path: Path) -> None:
    save_tiny_llava(tmp_path)
    local, frames = LocalLlava(tmp_path, "cpu"), [noise_image(40, 30, 1), np.full((28, 64, 3), 255, np.uint8)]
    question = LLAVA_QUESTIONS["noise_free"]
    answers = [local.ask(frame, question) for frame in frames]
    assert answers == [as_vistadream_asks(tmp_path, frame, question) for frame in frames]
    assert answers[0] != answers[1]  # the image does get there
    assert all(1 <= len(answer.split()) <= 200 for answer in answers)


@pytest.mark.slow
def test_a_folder_of_weights_to_scores_and_back_without_the_model(tmp_path: Path) -> None:
    save_tiny_llava(tmp_path / BAKLLAVA.name, "Yes")
    frames = np.stack([noise_image(20, 24, 1), noise_image(20, 24, 1), np.zeros((20, 24, 3), np.uint8)])
    options = MetricOptions(answers=tmp_path / "answers.jsonl")
    metric = Llava()
    metric.configure(options)
    found = metric.compute(given(frames, tmp_path))
    for score in found.values():
        assert (score.value, score.n) == (1.0, 3)
        assert score.detail["answers"] == [" ".join(["Yes"] * 200)] * 3
    assert len((tmp_path / "answers.jsonl").read_text().splitlines()) == 2 * 5
    digest = metric.specs(tmp_path)[0].weights_sha256
    assert digest is not None
    again = Llava()
    again.configure(options)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(LocalLlava, "ask", None)  # everything is in the file
        assert again.compute(given(frames, tmp_path)) == found


def test_another_model_in_the_folder_is_asked_anew(tmp_path: Path) -> None:
    folder = tmp_path / BAKLLAVA.name
    folder.mkdir(parents=True)
    (folder / "config.json").write_text("{}")
    first = Llava().specs(tmp_path)[0]
    (folder / ".cache").mkdir()
    (folder / ".cache" / "note").write_text("of a download tool")
    assert Llava().specs(tmp_path)[0] == first
    (folder / "model.safetensors").write_bytes(b"x")
    assert Llava().specs(tmp_path)[0].weights_sha256 != first.weights_sha256


@pytest.mark.parametrize("content", [{}, {"config.json": b"{}"}, {"config.json": b"\xff"}])
def test_a_folder_without_a_llava_is_bad_input(content: dict[str, bytes], tmp_path: Path) -> None:
    folder = tmp_path / BAKLLAVA.name
    folder.mkdir(parents=True)
    for name, value in content.items():
        (folder / name).write_bytes(value)
    with pytest.raises(BadInput, match="cannot be read as a LLaVA"):
        Llava().compute(given(noise_image(20, 20)[None], tmp_path))


def test_a_missing_model_names_the_folder_and_the_place(tmp_path: Path) -> None:
    for frames in (noise_image(20, 20)[None], np.zeros((0, 20, 20, 3), np.uint8)):
        with pytest.raises(Unavailable, match="llava-hf/bakLlava-v1-hf") as caught:
            Llava().compute(given(frames, tmp_path))
        assert str(tmp_path) in caught.value.given
        assert "https://" in caught.value.fix
    with pytest.raises(BadInput, match="frames of shape"):
        Llava().compute(given(np.zeros((20, 20, 3), np.uint8), tmp_path))


def test_specs_name_model_precision_and_question() -> None:
    specs = Llava().specs(None)
    assert [s.id for s in specs] == [f"llava_{criterion}" for criterion in LLAVA_QUESTIONS]
    for spec, question in zip(specs, LLAVA_QUESTIONS.values(), strict=True):
        assert spec.variant.startswith("llava-hf/bakLlava-v1-hf, fp16, greedy, 200 new tokens")
        assert spec.variant.endswith(question)
        assert (spec.higher_is_better, spec.bounds, spec.weights_sha256) == (True, (0.0, 1.0), None)


def test_answers_survive_a_kill_in_the_middle_of_a_line(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "answers.jsonl"
    first, second, third = (Question("model", "0" * 64, text) for text in ("a", "b", "c"))
    kept = Answers(path)
    kept.keep(first, 'yes\n"\udcff ü')
    kept.keep(second, "no")
    whole = path.read_bytes()
    path.write_bytes(whole[:-9])  # the second line is torn
    again = Answers(path)
    assert "1 broken lines" in caplog.text
    assert first in again
    assert second not in again
    again.keep(third, "no")
    last = Answers(path)
    assert last.given(first).startswith('yes\n"')
    assert last.given(third) == "no"
    assert second not in last


def test_two_processes_may_share_a_file_of_answers(tmp_path: Path) -> None:
    path, question = tmp_path / "answers.jsonl", Question("model", "0" * 64, "a")
    one, other = Answers(path), Answers(path)
    one.keep(question, "yes")
    other.keep(Question("model", "1" * 64, "a"), "no")
    assert [json.loads(line)["answer"] for line in path.read_text().splitlines()] == ["yes", "no"]


def test_a_file_of_answers_that_cannot_be_is_bad_input(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    with pytest.raises(BadInput, match="cannot be read"):
        Answers(tmp_path / "folder")
    (tmp_path / "file").write_text("")
    with pytest.raises(BadInput, match="cannot be written"):
        Answers(tmp_path / "file" / "answers.jsonl").keep(Question("m", "0", "t"), "yes")
