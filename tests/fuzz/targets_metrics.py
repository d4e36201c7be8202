"""What metrics read from elsewhere: replies of a model's server, priors and weights; and the texts of options."""

from __future__ import annotations

import io
import zipfile
from functools import cache
from types import SimpleNamespace
from typing import Any

from tests.fuzz.target import each, folder, input_file

__all__ = ["HEADS", "TRUNK", "chat", "niqe", "options", "weights"]

# The tensors that LPIPS of one layer would want: name in the file -> shape.
TRUNK = {"features.0.weight": (2, 3, 3, 3), "features.0.bias": (2,)}
HEADS = {"lin0.model.1.weight": (1, 2, 1, 1)}


class _Socket:
    """Answers whatever is asked with the same bytes."""

    def __init__(self, reply: bytes) -> None:
        self._reply = reply

    def makefile(self, mode: str) -> io.BytesIO:
        return io.BytesIO(self._reply)

    def sendall(self, content: bytes) -> None:
        """Nobody listens."""

    def close(self) -> None:
        """Nothing is open."""


def chat(content: bytes) -> None:
    """The reply of a server, status line and headers included."""
    import http.client

    from bench.metrics.chat_client import ChatClient
    from bench.metrics.llava_endpoint import LlavaEndpoint

    def connect(connection: Any) -> None:
        connection.sock = _Socket(content)

    before, http.client.HTTPConnection.connect = http.client.HTTPConnection.connect, connect  # type: ignore[method-assign]
    try:
        endpoint = LlavaEndpoint("http://127.0.0.1:1/v1", "m", attempts=2, backoff_s=0.0)
        ChatClient(endpoint, sleep=lambda _: None).ask("data:image/png;base64,", "?", 8)
    finally:
        http.client.HTTPConnection.connect = before  # type: ignore[method-assign]


def niqe(content: bytes) -> None:
    """The prior of NIQE: a MATLAB file."""
    from bench.metrics.natural_statistics import NiqePrior

    NiqePrior.read(input_file("prior.mat", content))


def weights(content: bytes) -> None:
    """The first byte says whether the rest is the pickle inside a sound archive (even) or the whole file (odd)."""
    from bench.metrics.lpips import head_state, trunk_state
    from bench.metrics.musiq import read_musiq_state

    path = folder() / "weights.pth"
    if content[:1] and content[0] % 2 == 0:
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("archive/data.pkl", content[1:])
            archive.writestr("archive/byteorder", b"little")
            archive.writestr("archive/version", b"3\n")
            for key in range(6):
                archive.writestr(f"archive/data/{key}", bytes(256))
    else:
        path.write_bytes(content[1:])
    network = _network()
    each(
        lambda: trunk_state(network, path),
        lambda: head_state(network, path),
        lambda: read_musiq_state(path),
    )


@cache
def _network() -> Any:
    import torch

    trunk = {name.replace("features.", "slice1."): torch.zeros(shape) for name, shape in TRUNK.items()}
    heads = {name: torch.zeros(shape) for name, shape in HEADS.items()}
    return SimpleNamespace(net=SimpleNamespace(state_dict=lambda: trunk), state_dict=lambda: heads)


def options(content: bytes) -> None:
    """A text as each of the options that have a small language: points, thresholds, SLURM's, shards."""
    from bench.adapters.points import is_point, parse_point
    from bench.compare import parse_thresholds
    from bench.executors.slurm import parse_options
    from bench.shard import parse_shard

    text = content.decode("utf-8", "surrogateescape")

    def point() -> None:
        if is_point(text):
            parse_point(text)

    each(point, lambda: parse_thresholds([text]), lambda: parse_options([text]), lambda: parse_shard(text))
