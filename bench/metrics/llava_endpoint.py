"""Where an OpenAI-compatible server is, and how patient to be with it. Imports nothing heavy."""

from __future__ import annotations

import math
from dataclasses import dataclass
from urllib.parse import urlsplit

from orca.errors import BadInput

__all__ = ["KEY_VARIABLE", "LlavaEndpoint"]

KEY_VARIABLE = "ORCA_LLAVA_API_KEY"  # the key is never an argument: arguments are kept with the results


@dataclass(frozen=True)
class LlavaEndpoint:
    """An OpenAI-compatible server of chat completions with images (vLLM, llama.cpp, ...).

    Attributes:
        url: its base ("http://localhost:8000/v1"), or the whole address of its chat completions.
        model: the model's name there.
        concurrency: requests at a time.
        timeout_s: seconds for one request, from connecting to the last byte of the answer.
        attempts: how often a request is made before its question is given up.
        backoff_s: seconds before the second attempt; twice as long before each further one.

    Raises:
        BadInput: a value that cannot be used.
    """

    url: str
    model: str
    concurrency: int = 4
    timeout_s: float = 60.0
    attempts: int = 4
    backoff_s: float = 0.5

    def __post_init__(self) -> None:
        if not _usable(self.url):
            raise BadInput(
                f"the LLaVA endpoint {self.url!r}",
                "http:// or https://, a host, and a path such as /v1; no user name, no query",
                f"give the base address of the server; a key goes into the variable {KEY_VARIABLE}",
            )
        if not self.model:
            raise BadInput("an endpoint without a model's name", "the name that the server uses", "give --llava-model")
        counts = {"requests at a time": self.concurrency, "attempts": self.attempts}
        for what, count in counts.items():
            if not 1 <= count <= 256:
                raise BadInput(f"{count} {what}", "1 to 256", "choose another number")
        if not (math.isfinite(self.timeout_s) and self.timeout_s > 0):
            raise BadInput(f"a timeout of {self.timeout_s} s", "a positive number of seconds", "try 60")

    @property
    def address(self) -> str:
        """The address that questions are posted to."""
        base = self.url.rstrip("/")
        return base if base.endswith("/chat/completions") else f"{base}/chat/completions"


def _usable(url: str) -> bool:
    try:
        parts = urlsplit(url)
        known = parts.scheme in ("http", "https") and bool(parts.hostname)
        return known and parts.port != 0 and not (parts.username or parts.password or parts.query or parts.fragment)
    except ValueError:  # a port that is no number, a broken IPv6 address
        return False
