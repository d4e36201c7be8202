"""LLaVA-IQA through an endpoint: a real server that answers yes, no, nonsense, slowly, badly, or not at all."""

from __future__ import annotations

import base64
import json
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from bench.metrics.chat_client import LARGEST_REPLY, ChatClient, Refused, Unanswered
from bench.metrics.llava import Llava
from bench.metrics.llava_asking import GIVE_UP_AFTER, png_data_url
from bench.metrics.llava_endpoint import LlavaEndpoint
from bench.metrics.llava_prompt import LLAVA_QUESTIONS, chat_text
from bench.metrics.metric import MetricOptions, Score
from orca.errors import BadInput, Unavailable
from tests.bench.chat_server import ChatServer, Reply, chat_server, completion, image_of
from tests.bench.learned_weights import given
from tests.bench.small_cases import noise_image

FRAMES = np.stack([noise_image(6, 5, k) for k in (1, 2, 1, 3)])  # three differ


@pytest.fixture
def server() -> Iterator[ChatServer]:
    with chat_server() as running:
        yield running


def endpoint_of(server: ChatServer, **changed: Any) -> LlavaEndpoint:
    return replace(LlavaEndpoint(server.url, "tiny", concurrency=2, timeout_s=5.0, backoff_s=0.001), **changed)


def llava(server: ChatServer, answers: Path | None = None, **changed: Any) -> Llava:
    metric = Llava()
    metric.configure(MetricOptions(endpoint_of(server, **changed), answers))
    return metric


def client(server: ChatServer, waited: list[float] | None = None, **changed: Any) -> ChatClient:
    return ChatClient(endpoint_of(server, **changed), (waited if waited is not None else []).append)


def scores(metric: Llava, frames: Any = FRAMES) -> dict[str, Score]:
    return metric.compute(given(frames, None))


def test_each_question_is_asked_once_of_each_distinct_frame(server: ChatServer) -> None:
    found = scores(llava(server))
    assert sorted(set(server.texts())) == sorted(chat_text(question) for question in LLAVA_QUESTIONS.values())
    assert len(server.requests) == 3 * 5
    assert set(server.paths) == {"/v1/chat/completions"}
    assert {name: score.value for name, score in found.items()} == {f"llava_{c}": 1.0 for c in LLAVA_QUESTIONS}
    assert {score.n for score in found.values()} == {4}
    body = server.requests[0]
    assert (body["model"], body["max_tokens"], body["temperature"]) == ("tiny", 200, 0)


def test_the_image_arrives_with_every_pixel_as_it_is(server: ChatServer) -> None:
    scores(llava(server, concurrency=1), FRAMES[:1])
    kind, _, content = image_of(server.requests[0]).partition(",")
    assert kind == "data:image/png;base64"
    decoded = cv2.imdecode(np.frombuffer(base64.b64decode(content), np.uint8), cv2.IMREAD_COLOR)
    assert np.array_equal(decoded[..., ::-1], FRAMES[0])


def test_yes_no_and_nonsense_are_counted_and_kept(server: ChatServer, caplog: pytest.LogCaptureFixture) -> None:
    by_frame = {png_data_url(FRAMES[0]): " YES, it is.", png_data_url(FRAMES[1]): "no", png_data_url(FRAMES[3]): "hm"}

    def reply(text: str, before: int) -> Reply:
        return by_frame[image_of(server.requests[-1])]

    server.reply = reply
    found = scores(llava(server, concurrency=1))["llava_edge"]
    assert found.value == 0.5
    assert found.per_frame == (1.0, 0.0, 1.0, None)
    assert found.detail == {"yes": 2, "no": 1, "unparsed": 1, "answers": [" YES, it is.", "no", " YES, it is.", "hm"]}
    assert "1 of 4 answers are neither yes nor no" in caplog.text


@pytest.mark.parametrize(
    "trouble",
    [
        ("status", 500),
        ("status", 429),
        ("drop", b""),
        ("drop", b'{"choices"'),
        ("raw", b"<html>busy</html>"),
        ("raw", b'{"choices": []}'),
        ("raw", completion("x").replace(b'"x"', b"null")),
        ("raw", b"[" * 100_000),
        ("raw", b" " * (LARGEST_REPLY + 10)),
    ],
)
def test_trouble_that_passes_is_asked_again(server: ChatServer, trouble: Reply) -> None:
    server.reply = lambda text, before: trouble if before < 2 else "Yes"
    waited: list[float] = []
    assert client(server, waited, backoff_s=0.25).ask("data:x", "t", 200) == "Yes"
    assert len(server.requests) == 3
    assert waited == [0.25, 0.5]


def test_the_server_says_how_long_to_wait(server: ChatServer) -> None:
    afters = ["3", "not a number", "100000"]
    server.reply = lambda text, before: ("status", (503, {"Retry-After": afters[before]})) if before < 3 else "No"
    waited: list[float] = []
    assert client(server, waited, backoff_s=0.25).ask("data:x", "t", 200) == "No"
    assert waited == [3.0, 0.5, 30.0]


def test_attempts_are_bounded(server: ChatServer) -> None:
    server.reply = lambda text, before: ("status", 500)
    with pytest.raises(Unanswered, match="in 3 attempts; the last: HTTP 500: sorry"):
        client(server, attempts=3).ask("data:x", "t", 200)
    assert len(server.requests) == 3


@pytest.mark.parametrize("slowness", [("wait", 30.0), ("drip", 0.05)])
def test_a_slow_answer_ends_with_the_timeout(server: ChatServer, slowness: Reply) -> None:
    """A byte now and then does not keep a request alive: the limit is for the whole of it."""
    server.reply = lambda text, before: slowness if before == 0 else "Yes"
    assert client(server, timeout_s=1.0).ask("data:x", "t", 200) == "Yes"
    server.reply = lambda text, before: slowness
    with pytest.raises(Unanswered, match=r"no reply within 0\.5 s"):
        client(server, timeout_s=0.5, attempts=1).ask("data:y", "t", 200)


@pytest.mark.parametrize("code", [400, 401, 404, 301])
def test_a_refusal_ends_it_at_once(server: ChatServer, code: int) -> None:
    server.reply = lambda text, before: ("status", code)
    with pytest.raises(Refused, match=f"HTTP {code}"):
        client(server).ask("data:x", "t", 200)
    with pytest.raises(Unavailable, match="15 of 15 questions were not answered"):
        scores(llava(server, concurrency=1))
    assert len(server.requests) == 2


def test_no_server_is_unavailable_and_soon_given_up() -> None:
    with chat_server() as gone:
        pass
    with pytest.raises(Unavailable, match="15 of 15 questions were not answered") as caught:
        scores(llava(gone, attempts=2))
    assert "--retry-failed" in caught.value.fix


def test_a_server_that_died_is_not_asked_everything(server: ChatServer) -> None:
    server.reply = lambda text, before: ("status", 500)
    with pytest.raises(Unavailable, match="15 of 15"):
        scores(llava(server, concurrency=1, attempts=2))
    assert len(server.requests) == 2 * GIVE_UP_AFTER


def test_nothing_answered_is_asked_again(server: ChatServer, tmp_path: Path) -> None:
    """One question fails at first: the others are kept in the file, and a later run asks that one alone."""
    answers, bad = tmp_path / "deep" / "answers.jsonl", chat_text(LLAVA_QUESTIONS["detail"])
    server.reply = lambda text, before: ("status", 500) if text == bad else "No"
    with pytest.raises(Unavailable, match="3 of 15 questions were not answered"):
        scores(llava(server, answers, attempts=1))
    lines = [json.loads(line) for line in answers.read_text().splitlines()]
    assert [line["answer"] for line in lines] == ["No"] * 12
    asked = len(server.requests)
    server.reply = lambda text, before: "Yes"
    found = scores(llava(server, answers))
    assert server.texts()[asked:] == [bad] * 3
    assert (found["llava_detail"].value, found["llava_edge"].value) == (1.0, 0.0)
    assert scores(llava(server, answers))["llava_detail"].value == 1.0
    assert len(server.requests) == asked + 3


def test_an_interruption_keeps_what_was_answered(server: ChatServer, tmp_path: Path) -> None:
    answers = tmp_path / "answers.jsonl"
    metric = llava(server, answers, concurrency=1)
    original, count = ChatClient.ask, iter(range(100))

    def interrupted(self: ChatClient, image: str, text: str, tokens: int) -> str:
        if next(count) >= 7:
            raise KeyboardInterrupt
        return original(self, image, text, tokens)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ChatClient, "ask", interrupted)
        with pytest.raises(KeyboardInterrupt):
            scores(metric)
    assert len(answers.read_text().splitlines()) == 7
    assert scores(llava(server, answers))["llava_edge"].value == 1.0
    assert len(server.requests) == 15


def test_other_models_and_other_frames_are_other_questions(server: ChatServer, tmp_path: Path) -> None:
    answers = tmp_path / "answers.jsonl"
    scores(llava(server, answers), FRAMES[:1])
    scores(llava(server, answers, model="another"), FRAMES[:1])
    scores(llava(server, answers), FRAMES[:1].transpose(0, 2, 1, 3))
    assert len(server.requests) == 15


def test_requests_at_a_time_are_bounded_and_used(server: ChatServer) -> None:
    gate = threading.Barrier(3)

    def reply(text: str, before: int) -> Reply:
        gate.wait(timeout=60)  # passes only while three requests are open together
        return "Yes"

    server.reply = reply
    scores(llava(server, concurrency=3))
    assert server.most_at_once == 3


def test_a_key_is_sent_and_never_kept(server: ChatServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ORCA_LLAVA_API_KEY", "secret")
    answers = tmp_path / "answers.jsonl"
    metric = llava(server, answers)
    scores(metric, FRAMES[:1])
    assert server.headers["Authorization"] == "Bearer secret"
    assert "secret" not in answers.read_text() + str(metric.specs(None))


def test_no_frames_ask_nothing(server: ChatServer) -> None:
    found = scores(llava(server), np.zeros((0, 8, 8, 3), np.uint8))
    assert {(score.value, score.reason) for score in found.values()} == {(None, "no frames")}
    assert not server.requests
    with pytest.raises(BadInput, match="frames of shape"):
        scores(llava(server), FRAMES.astype(np.float32) * np.nan)


@pytest.mark.parametrize(
    "changed",
    [
        {"url": "localhost:8000"},
        {"url": "ftp://host/v1"},
        {"url": "http://user:word@host/v1"},
        {"url": "http://host:port/v1"},
        {"url": "http:///v1"},
        {"model": ""},
        {"concurrency": 0},
        {"attempts": 0},
        {"timeout_s": 0.0},
        {"timeout_s": float("nan")},
    ],
)
def test_an_endpoint_that_cannot_be_is_bad_input(changed: dict[str, Any]) -> None:
    with pytest.raises(BadInput):
        LlavaEndpoint(**{"url": "http://localhost:8000/v1", "model": "m", **changed})


def test_the_address_is_the_base_or_the_whole() -> None:
    for url in ("http://h:8/v1", "http://h:8/v1/", "http://h:8/v1/chat/completions"):
        assert LlavaEndpoint(url, "m").address == "http://h:8/v1/chat/completions"
