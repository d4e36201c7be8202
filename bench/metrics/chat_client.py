"""One question to an OpenAI-compatible server: bounded in time and size, repeated where that can help."""

from __future__ import annotations

import http.client
import json
import logging
import os
import socket
import ssl
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any
from urllib.parse import urlsplit

from bench.metrics.llava_endpoint import KEY_VARIABLE, LlavaEndpoint
from orca.errors import Unavailable

__all__ = ["ChatClient", "Refused", "Unanswered"]

_log = logging.getLogger(__name__)

LARGEST_REPLY = 1 << 20  # 200 tokens are some kilobytes
LONGEST_WAIT_S = 30.0
WORTH_REPEATING = frozenset({408, 409, 425, 429, 500, 502, 503, 504, 529})


class Unanswered(Unavailable):
    """A question that was not answered after all attempts; others may be."""


class Refused(Unavailable):
    """The server does not take such requests at all (wrong model, no such address, no rights)."""


class _TryAgain(Exception):
    def __init__(self, why: str, wait_s: float = 0.0) -> None:
        self.wait_s = wait_s
        super().__init__(why)


class ChatClient:
    """Asks one server; may be used from several threads, each request on a connection of its own.

    Args:
        endpoint: where, and how patiently.
        sleep: waits between attempts.
    """

    def __init__(self, endpoint: LlavaEndpoint, sleep: Callable[[float], object] = time.sleep) -> None:
        self._endpoint, self._sleep = endpoint, sleep

    def ask(self, image_url: str, text: str, max_tokens: int) -> str:
        """The model's answer to a text about an image, greedy.

        Args:
            image_url: the image as a data URL.
            text: what the user says.
            max_tokens: length of the answer at most.

        Raises:
            Unanswered: every attempt failed.
            Refused: the server said that no such request can succeed.
        """
        content = [{"type": "image_url", "image_url": {"url": image_url}}, {"type": "text", "text": text}]
        request = {
            "model": self._endpoint.model,
            "messages": [{"role": "user", "content": content}],
            "max_tokens": max_tokens,
            "temperature": 0,
        }
        body, why = json.dumps(request).encode(), ""
        for attempt in range(self._endpoint.attempts):
            if attempt:
                _log.debug("%s: asking again after: %s", self._endpoint.address, why)
            try:
                return self._post(body)
            except _TryAgain as error:
                why, wait = str(error), max(error.wait_s, self._endpoint.backoff_s * 2**attempt)
                if attempt + 1 < self._endpoint.attempts:
                    self._sleep(min(wait, LONGEST_WAIT_S))
        raise Unanswered(
            f"{self._endpoint.address} gave no answer in {self._endpoint.attempts} attempts; the last: {why}",
            "a chat completion",
            "see that the server runs and is not overloaded (--llava-timeout, --llava-concurrency)",
        )

    def _post(self, body: bytes) -> str:
        deadline, limit = time.monotonic() + self._endpoint.timeout_s, f"no reply within {self._endpoint.timeout_s:g} s"
        parts = urlsplit(self._endpoint.address)
        kind = http.client.HTTPSConnection if parts.scheme == "https" else http.client.HTTPConnection
        connection = kind(parts.hostname or "", parts.port, timeout=self._endpoint.timeout_s)
        headers = {"Content-Type": "application/json"}
        if key := os.environ.get(KEY_VARIABLE):
            headers["Authorization"] = f"Bearer {key}"
        try:
            connection.connect()
            with _closed_after(connection, deadline - time.monotonic()):
                connection.request("POST", parts.path, body, headers)
                response = connection.getresponse()
                reply = response.read(LARGEST_REPLY + 1)
        except ssl.SSLCertVerificationError as error:
            raise self._refused(f"its certificate is not trusted ({error})") from error
        except (OSError, http.client.HTTPException) as error:
            late = time.monotonic() >= deadline
            raise _TryAgain(limit if late else f"{type(error).__name__}: {error}") from error
        finally:
            connection.close()
        if time.monotonic() >= deadline:  # cut off, which a reply without a length does not show
            raise _TryAgain(limit)
        if response.status != 200:
            self._complain(response.status, reply, response.getheader("Retry-After"))
        return _answer_in(reply)

    def _complain(self, status: int, reply: bytes, retry_after: str | None) -> None:
        said = f"HTTP {status}: {' '.join(reply[:300].decode('utf-8', 'replace').split())}"
        if status in WORTH_REPEATING:
            seconds = (retry_after or "").strip()  # or a date, which is not heeded
            raise _TryAgain(said, float(seconds) if seconds.isascii() and seconds.isdecimal() else 0.0)
        raise self._refused(said)

    def _refused(self, why: str) -> Refused:
        return Refused(
            f"{self._endpoint.address} refuses: {why}",
            "a server of chat completions with images that knows the model",
            f"check --llava-url and --llava-model (and {KEY_VARIABLE} where a key is asked for)",
        )


@contextmanager
def _closed_after(connection: http.client.HTTPConnection, seconds: float) -> Iterator[None]:
    """End what reads from a connection after some time: a socket's own timeout starts anew with every byte."""

    def shut(sock: socket.socket) -> None:
        try:
            socket.socket.shutdown(sock, socket.SHUT_RDWR)  # under TLS too: an SSLSocket's own is not thread-safe
        except OSError:
            _log.debug("the server had closed the connection already")

    timer = threading.Timer(max(seconds, 0.0), shut, [connection.sock])
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def _answer_in(reply: bytes) -> str:
    if len(reply) > LARGEST_REPLY:
        raise _TryAgain(f"a reply of more than {LARGEST_REPLY} bytes")
    try:
        document: Any = json.loads(reply)
        answer = document["choices"][0]["message"]["content"]
    except (ValueError, LookupError, TypeError, RecursionError) as error:
        start = reply[:200].decode("utf-8", "replace")
        raise _TryAgain(f"a reply that is no chat completion ({type(error).__name__}): {start!r}") from error
    if not isinstance(answer, str):
        raise _TryAgain(f"an answer that is no text: {str(answer)[:200]}")
    return answer
