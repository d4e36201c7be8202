"""LLaVA-IQA inside a run: the options of the command line, answers beside the results, a run that goes on."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import pytest

from bench.arguments import add_run
from bench.commands.run import _llava_endpoint
from bench.metrics import METRICS, MetricOptions
from bench.metrics.llava_endpoint import LlavaEndpoint
from bench.metrics.llava_prompt import LLAVA_QUESTIONS, chat_text
from bench.runner import RunRequest, RunSummary, run_bench
from bench.store import RunStore
from orca.errors import BadInput
from tests.bench import spine_fakes as fakes
from tests.bench.chat_server import chat_server
from tests.bench.spine_fakes import FakeDataset


def parsed(*argv: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_run(parser)
    return parser.parse_args(argv)


def test_options_of_the_command_line_are_those_of_the_endpoint() -> None:
    assert _llava_endpoint(parsed()) is None
    plain = _llava_endpoint(parsed("--llava-url", "http://h:8/v1", "--llava-model", "m"))
    assert plain == LlavaEndpoint("http://h:8/v1", "m")
    full = ("--llava-url", "http://h/v1", "--llava-model", "m", "--llava-concurrency", "9", "--llava-timeout", "2.5")
    assert _llava_endpoint(parsed(*full)) == LlavaEndpoint("http://h/v1", "m", concurrency=9, timeout_s=2.5)


def test_the_help_states_the_defaults_that_hold() -> None:
    """The help is written without importing the endpoint's class; here they are held together."""
    parser = argparse.ArgumentParser()
    add_run(parser)
    help_text = " ".join(parser.format_help().split())
    endpoint = LlavaEndpoint("http://h/v1", "m")
    assert f"requests at a time ({endpoint.concurrency})" in help_text
    assert f"seconds for a request ({endpoint.timeout_s:g})" in help_text


@pytest.mark.parametrize(
    "argv", [("--llava-model", "m"), ("--llava-url", "http://h/v1"), ("--llava-url", "h", "--llava-model", "m")]
)
def test_half_an_endpoint_is_bad_input(argv: tuple[str, ...]) -> None:
    with pytest.raises(BadInput):
        _llava_endpoint(parsed(*argv))


def test_a_run_keeps_answers_and_asks_only_what_is_open(tmp_path: Path) -> None:
    fakes.reset()
    out, bad = tmp_path / "run", chat_text(LLAVA_QUESTIONS["edge"])

    def go(url: str, retry: bool = False) -> RunSummary:
        options = MetricOptions(LlavaEndpoint(url, "tiny", attempts=1, backoff_s=0.001))
        request = RunRequest(
            FakeDataset(), ("a", "b"), ("dark",), ("llava_edge",), out, retry_failed=retry, metric_options=options
        )
        return run_bench(request, methods=fakes.METHODS, metrics=METRICS)

    def status(scene: str) -> tuple[str, float | None]:
        record = RunStore(out).load("dark", scene)
        assert record is not None
        return record.scores["llava_edge"].status, record.scores["llava_edge"].value

    with chat_server() as server:
        server.reply = lambda text, before: ("status", 500) if text == bad else "Yes"
        go(server.url)
        assert status("a") == ("unavailable", None)
        lines = (out / "answers" / "llava.jsonl").read_text().splitlines()
        assert [json.loads(line)["answer"] for line in lines] == ["Yes"] * 3 * 4  # both scenes have the same frames
        asked = len(server.requests)
        server.reply = lambda text, before: "no"
        go(server.url, retry=True)
        assert server.texts()[asked:] == [bad] * 3
        assert status("a") == status("b") == ("ok", 0.0)
        asked = len(server.requests)
        assert go(server.url).computed == 0
        assert len(server.requests) == asked
