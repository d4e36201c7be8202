"""Runs a job many times over in forks of one clean process, so that killing one costs milliseconds, not an import.

``python -m tests.faults.forks MODULE:FUNCTION`` reads a JSON object a line (the job's arguments, and ``env``), calls
FUNCTION in a fork and answers with a line of JSON: exit code (negative for a signal) and what the function returned.
"""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

__all__ = ["ONE_THREAD", "Forks", "Outcome"]

ONE_THREAD = {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
"""Everywhere, workers included: tables name the threads of results that differ in them."""


@dataclass(frozen=True)
class Outcome:
    """How a job ended: its exit code, negative for a signal, and what it returned (None if it did not)."""

    code: int
    answer: Any
    said: str = ""


class Forks:
    """The process that forks; a context manager."""

    def __init__(self, job: str) -> None:
        root = Path(__file__).resolve().parents[2]
        env = {key: value for key, value in os.environ.items() if key != "ORCA_FAULT"} | ONE_THREAD
        command = [sys.executable, "-m", "tests.faults.forks", job]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=root, env=env, text=True
        )

    def run(self, env: dict[str, str] | None = None, **arguments: Any) -> Outcome:
        """Run the job once; ``env`` is added to the environment of this one fork."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        print(json.dumps({"env": env or {}, "arguments": arguments}), file=self._process.stdin, flush=True)
        return Outcome(**json.loads(self._process.stdout.readline()))

    def __enter__(self) -> Forks:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()


def _forked(job: Callable[..., Any], asked: dict[str, Any]) -> dict[str, Any]:
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reader)
        code, answer, said = 1, None, ""
        try:
            os.environ.update(asked["env"])
            answer, code = job(**asked["arguments"]), 0
        except BaseException:  # noqa: BLE001 - told to the parent
            said = traceback.format_exc()
        with os.fdopen(writer, "w") as pipe:
            json.dump({"answer": answer, "said": said}, pipe)
        os._exit(code)
    os.close(writer)
    with os.fdopen(reader) as pipe:
        text = pipe.read()
    _, status = os.waitpid(child, 0)
    told = json.loads(text) if text else {"answer": None, "said": ""}
    return {"code": os.waitstatus_to_exitcode(status), **told}


def main() -> None:
    """Serve until the input ends."""
    module, _, name = sys.argv[1].partition(":")
    job = getattr(importlib.import_module(module), name)
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what the job prints must not be taken for an answer
    for line in sys.stdin:
        print(json.dumps(_forked(job, json.loads(line))), file=answers, flush=True)


if __name__ == "__main__":
    main()
