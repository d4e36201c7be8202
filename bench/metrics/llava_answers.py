"""Raw answers of a vision-language model, kept as soon as they are given, so that nothing is asked twice."""

from __future__ import annotations

import errno
import json
import logging
import os
import threading
from dataclasses import asdict, dataclass
from pathlib import Path

from orca.errors import BadInput, CannotWrite
from orca.faults import fault_point

__all__ = ["Answers", "Question"]

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Question:
    """One question about one frame.

    Attributes:
        asked_of: the model and how it is reached, as the metric's spec says it.
        frame_sha256: hash of the frame's pixels and shape.
        text: the question.
    """

    asked_of: str
    frame_sha256: str
    text: str


class Answers:
    """Answers by question: a file of one JSON object a line, only ever added to.

    Each line is written by one call and flushed to the disk, so several processes may share the file, and a kill costs
    the line being written at most. A line that cannot be read is left where it is and its question is asked again.

    Args:
        path: the file; None to keep answers in memory only.

    Raises:
        BadInput: the file cannot be opened.
    """

    def __init__(self, path: Path | None) -> None:
        self._path, self._lock = path, threading.Lock()
        self._known: dict[Question, str] = {}
        self._torn = False
        if path is not None and path.exists():
            self._read(path)

    def __contains__(self, question: Question) -> bool:
        return question in self._known

    def given(self, question: Question) -> str:
        """The answer to a question that has one."""
        return self._known[question]

    def keep(self, question: Question, answer: str) -> None:
        """Keep an answer; may be called from several threads."""
        with self._lock:
            if self._path is not None:
                self._append(self._path, {**asdict(question), "answer": answer})
            self._known[question] = answer

    def _append(self, path: Path, entry: dict[str, str]) -> None:
        line = ("\n" if self._torn else "") + json.dumps(entry, ensure_ascii=False) + "\n"
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            file = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
            try:
                fault_point("made", path)
                content = line.encode("utf-8", "backslashreplace")
                if os.write(file, content) < len(content):
                    self._torn = True
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
                os.fsync(file)
                fault_point("named", path)
            finally:
                os.close(file)
        except OSError as error:
            raise CannotWrite(
                f"{path} cannot be written ({error})", "a file that can be added to", "see --out, or free some space"
            ) from error
        self._torn = False

    def _read(self, path: Path) -> None:
        try:
            content = path.read_bytes()
        except OSError as error:
            raise BadInput(f"{path} cannot be read ({error})", "a file of answers", "move it away") from error
        unread = 0
        for line in content.splitlines():
            try:
                entry = json.loads(line)
                question = Question(entry["asked_of"], entry["frame_sha256"], entry["text"])
                self._known[question] = str(entry["answer"])
            except (ValueError, KeyError, TypeError, RecursionError):
                unread += bool(line.strip())
        self._torn = bool(content) and not content.endswith(b"\n")
        if unread:
            _log.warning("%s: %d broken lines; their questions are asked again", path, unread)
