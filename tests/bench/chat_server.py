"""A real HTTP server on the loopback that answers as an OpenAI-compatible one would, or badly, as it is told."""

from __future__ import annotations

import contextlib
import json
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

Reply = str | tuple[str, Any]


@dataclass
class ChatServer:
    """What the server does and has seen.

    Attributes:
        reply: given the text of a question and how often it was asked before, the answer, or ("status", code),
            ("raw", bytes), ("drop", bytes sent before), ("drip", seconds between bytes), ("wait", seconds).
        requests: the bodies of all requests, decoded.
        headers: the headers of the last request.
        most_at_once: the largest number of requests that were open at the same time.
    """

    reply: Callable[[str, int], Reply] = lambda text, before: "Yes"
    requests: list[dict[str, Any]] = field(default_factory=list)
    paths: list[str] = field(default_factory=list)
    headers: dict[str, str] = field(default_factory=dict)
    most_at_once: int = 0
    url: str = ""
    stopped: threading.Event = field(default_factory=threading.Event)
    _seen: Counter[str] = field(default_factory=Counter)
    _open: int = 0
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def texts(self) -> list[str]:
        """The question of each request."""
        return [text_of(body) for body in self.requests]

    def take(self, handler: BaseHTTPRequestHandler) -> Reply:
        body = json.loads(handler.rfile.read(int(handler.headers["Content-Length"])))
        with self._lock:
            self._open += 1
            self.most_at_once = max(self.most_at_once, self._open)
            self.requests.append(body)
            self.paths.append(handler.path)
            self.headers = dict(handler.headers)
            key = json.dumps(body["messages"])
            before = self._seen[key]
            self._seen[key] += 1
        return self.reply(text_of(body), before)

    def done(self) -> None:
        with self._lock:
            self._open -= 1


def text_of(body: dict[str, Any]) -> str:
    (text,) = (part["text"] for part in body["messages"][0]["content"] if part["type"] == "text")
    return str(text)


def image_of(body: dict[str, Any]) -> str:
    (url,) = (part["image_url"]["url"] for part in body["messages"][0]["content"] if part["type"] == "image_url")
    return str(url)


def completion(answer: str) -> bytes:
    return json.dumps({"choices": [{"message": {"role": "assistant", "content": answer}}]}).encode()


@contextmanager
def chat_server() -> Iterator[ChatServer]:
    """A server on a free port of the loopback, until the end of the block."""
    state = ChatServer()

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            try:
                reply = state.take(self)
            finally:
                state.done()  # before the client hears of it, and asks the next
            with contextlib.suppress(OSError):  # the client has gone: what several tests are about
                _send(self, state, reply)

        def log_message(self, *args: Any) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
    thread.start()
    state.url = f"http://127.0.0.1:{server.server_address[1]}/v1"
    try:
        yield state
    finally:
        state.stopped.set()
        server.shutdown()
        server.server_close()
        thread.join()


def _send(handler: BaseHTTPRequestHandler, state: ChatServer, reply: Reply) -> None:
    kind, value = ("raw", completion(reply)) if isinstance(reply, str) else reply
    if kind == "status":
        code, headers = value if isinstance(value, tuple) else (value, {})
        _head(handler, code, 5, headers)
        handler.wfile.write(b"sorry")
        return
    if kind == "wait":
        state.stopped.wait(value)
        kind, value = "raw", completion("Yes")
    body = value if kind in ("raw", "drop") else completion("Yes")
    _head(handler, 200, len(body) + (1000 if kind == "drop" else 0), {})
    if kind == "drip":
        for byte in body:
            handler.wfile.write(bytes([byte]))
            handler.wfile.flush()
            if state.stopped.wait(value):
                return
        return
    handler.wfile.write(body)
    if kind == "drop":
        handler.wfile.flush()
        time.sleep(0.01)
        handler.connection.close()


def _head(handler: BaseHTTPRequestHandler, code: int, length: int, headers: dict[str, str]) -> None:
    handler.send_response(code)
    for name, value in {"Content-Length": str(length), "Connection": "close", **headers}.items():
        handler.send_header(name, value)
    handler.end_headers()
