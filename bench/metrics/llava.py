"""LLaVA-IQA as VistaDream defines it: the share of frames for which a vision-language model answers yes."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from bench.metrics.chat_client import ChatClient
from bench.metrics.llava_answers import Answers, Question
from bench.metrics.llava_asking import Job, ask_endpoint
from bench.metrics.llava_local import LocalLlava
from bench.metrics.llava_prompt import LLAVA_MODEL, LLAVA_QUESTIONS, NEW_TOKENS, said_yes
from bench.metrics.metric import MetricInput, MetricOptions, MetricSpec, Score
from bench.metrics.per_frame import check_frames, frame_sha256
from bench.metrics.weights import WeightsFile
from orca.conventions import UInt8Array

__all__ = ["BAKLLAVA", "Llava"]

_log = logging.getLogger(__name__)

BAKLLAVA = WeightsFile("llava", LLAVA_MODEL, f"https://huggingface.co/{LLAVA_MODEL}")
_RULE = 'share of frames whose answer starts with "yes"'


class Llava:
    """Five questions a frame, to the model on this machine or to an endpoint; what is answered is never asked again."""

    needs = ("frames", "shape")

    def __init__(self) -> None:
        self._options = MetricOptions()
        self._answers: Answers | None = None
        self._local: tuple[tuple[Path, str], LocalLlava] | None = None

    def configure(self, options: MetricOptions) -> None:
        """Take the endpoint, if there is one, and the file of answers."""
        self._options, self._answers = options, None

    def specs(self, weights_dir: Path | None) -> tuple[MetricSpec, ...]:
        """The specs of the five criteria."""
        digest = BAKLLAVA.sha256(weights_dir) if self._options.llava is None else None
        return tuple(
            MetricSpec(
                f"llava_{criterion}",
                f"LLaVA {criterion.replace('_', '-')}",
                True,
                (0.0, 1.0),
                f"{self._asked_of()}, greedy, {NEW_TOKENS} new tokens; {_RULE}; asked: {question}",
                self._made_by(),
                3,
                digest,
            )
            for criterion, question in LLAVA_QUESTIONS.items()
        )

    def compute(self, given: MetricInput) -> dict[str, Score]:
        """Score the frames.

        Raises:
            Unavailable: the model is not there, or the endpoint left questions open; answers that came are kept.
            BadInput: the frames are not [n, H, W, 3] uint8, or the model or the file of answers cannot be read.
        """
        frames = given.output.frames
        check_frames(frames)
        asked_of = self._asked_of()
        if self._options.llava is None:
            BAKLLAVA.find(given.weights_dir)
            asked_of += f", {BAKLLAVA.sha256(given.weights_dir)}"
        if self._answers is None:
            self._answers = Answers(self._options.answers)
        hashes = [frame_sha256(frame) for frame in frames]
        if jobs := _open_jobs(self._answers, asked_of, frames, hashes):
            self._ask(jobs, self._answers, given)
        scores = {}
        for criterion, text in LLAVA_QUESTIONS.items():
            answers = [self._answers.given(Question(asked_of, digest, text)) for digest in hashes]
            scores[f"llava_{criterion}"] = _score(answers, criterion)
        return scores

    def _ask(self, jobs: Sequence[Job], answers: Answers, given: MetricInput) -> None:
        endpoint = self._options.llava
        if endpoint is not None:
            ask_endpoint(ChatClient(endpoint), jobs, answers.keep, endpoint.concurrency)
            return
        key = (BAKLLAVA.find(given.weights_dir), given.device)
        if self._local is None or self._local[0] != key:
            self._local = (key, LocalLlava(*key))
        for job in jobs:
            for question in job.questions:
                answers.keep(question, self._local[1].ask(job.frame, question.text))

    def _asked_of(self) -> str:
        endpoint = self._options.llava
        if endpoint is None:
            return f"{LLAVA_MODEL}, fp16"
        return f"model {endpoint.model!r} behind an OpenAI-compatible endpoint (its chat template and precision)"

    def _made_by(self) -> str:
        if self._options.llava is not None:
            return "bench 1"
        try:
            return f"bench 1, transformers {version('transformers')}"
        except PackageNotFoundError:
            return "bench 1, no transformers"


def _open_jobs(answers: Answers, asked_of: str, frames: UInt8Array, hashes: Sequence[str]) -> list[Job]:
    """The questions that have no answer yet, frame by frame, equal frames once."""
    jobs: dict[str, Job] = {}
    for frame, digest in zip(frames, hashes, strict=True):
        every = (Question(asked_of, digest, text) for text in LLAVA_QUESTIONS.values())
        missing = tuple(question for question in every if question not in answers)
        if missing and digest not in jobs:
            jobs[digest] = Job(frame, missing)
    return list(jobs.values())


def _score(answers: list[str], criterion: str) -> Score:
    """The share of yes; what is neither yes nor no is counted, shown, and is no yes."""
    if not answers:
        return Score(None, 0, "no frames", ())
    verdicts = [said_yes(answer) for answer in answers]
    counts = {"yes": verdicts.count(True), "no": verdicts.count(False), "unparsed": verdicts.count(None)}
    if counts["unparsed"]:
        _log.warning("LLaVA %s: %d of %d answers are neither yes nor no", criterion, counts["unparsed"], len(answers))
    per_frame = tuple(None if verdict is None else float(verdict) for verdict in verdicts)
    return Score(counts["yes"] / len(answers), len(answers), None, per_frame, {**counts, "answers": answers})
