"""A fault: one edit of one file, and the tests that must notice it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

__all__ = ["Fault", "faulty_text"]


@dataclass(frozen=True)
class Fault:
    """One edit.

    Attributes:
        name: what is wrong, in words.
        path: the file, from the root of the repository.
        right: text that stands there exactly once.
        wrong: what replaces it.
        tests: test files that must fail, the fastest first.
    """

    name: str
    path: str
    right: str
    wrong: str
    tests: tuple[str, ...]


def faulty_text(fault: Fault, root: Path) -> str:
    """The file's text with the fault in it; raises `ValueError` unless the right text stands there exactly once."""
    text = (root / fault.path).read_text(encoding="utf-8")
    if text.count(fault.right) != 1:
        raise ValueError(f"'{fault.name}': its text stands {text.count(fault.right)} times in {fault.path}, not once")
    return text.replace(fault.right, fault.wrong)
