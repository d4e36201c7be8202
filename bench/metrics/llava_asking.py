"""Questions that are still open, put to an endpoint: several at a time, each answer kept at once."""

from __future__ import annotations

import base64
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2

from bench.metrics.chat_client import ChatClient, Refused, Unanswered
from bench.metrics.llava_answers import Question
from bench.metrics.llava_prompt import NEW_TOKENS, chat_text
from orca.conventions import UInt8Array
from orca.errors import OrcaError, Unavailable

__all__ = ["Job", "ask_endpoint", "png_data_url"]

# So many questions in a row without an answer mean that the server is down: the rest are not asked.
GIVE_UP_AFTER = 5

Keep = Callable[[Question, str], None]


@dataclass(frozen=True, eq=False)
class Job:
    """One frame [H, W, 3] uint8 and the questions about it that have no answer yet."""

    frame: UInt8Array
    questions: tuple[Question, ...]


def ask_endpoint(client: ChatClient, jobs: Sequence[Job], keep: Keep, concurrency: int) -> None:
    """Put all questions; the questions of a frame one after another, several frames at a time.

    Raises:
        Unavailable: some were not answered, after all others were; the server refused, or gave no answer to several
            questions in a row. What was answered has been kept.
    """
    run = _Run(client, keep)
    pool = ThreadPoolExecutor(min(concurrency, max(1, len(jobs))), thread_name_prefix="llava")
    try:
        for future in [pool.submit(run.frame, job) for job in jobs]:
            future.result()
    except BaseException:  # an interruption, or an answer that cannot be kept: ask nothing more
        run.stop.set()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
    total = sum(len(job.questions) for job in jobs)
    if run.error is not None:
        raise Unavailable(
            f"{total - run.answered} of {total} questions were not answered: {run.error.given}",
            run.error.allowed,
            f"{run.error.fix}; then run again with --retry-failed: only what is open is asked",
        )


class _Run:
    """What the threads of one call share."""

    def __init__(self, client: ChatClient, keep: Keep) -> None:
        self.stop = threading.Event()
        self.answered = 0
        self.error: OrcaError | None = None
        self._client, self._keep = client, keep
        self._lock, self._in_a_row = threading.Lock(), 0

    def frame(self, job: Job) -> None:
        image = png_data_url(job.frame)
        for question in job.questions:
            if self.stop.is_set():
                return
            try:
                answer = self._client.ask(image, chat_text(question.text), NEW_TOKENS)
            except (Unanswered, Refused) as error:
                self._failed(error)
                continue
            self._keep(question, answer)
            with self._lock:
                self.answered, self._in_a_row = self.answered + 1, 0

    def _failed(self, error: OrcaError) -> None:
        with self._lock:
            self.error, self._in_a_row = error, self._in_a_row + 1
            if isinstance(error, Refused) or self._in_a_row >= GIVE_UP_AFTER:
                self.stop.set()


def png_data_url(frame: UInt8Array) -> str:
    """A frame [H, W, 3] uint8 RGB as a data URL of a PNG: every pixel as it is."""
    _, png = cv2.imencode(".png", frame[..., ::-1])
    return f"data:image/png;base64,{base64.b64encode(png.tobytes()).decode()}"
