"""What a verb hands back to the command line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

__all__ = ["Outcome"]


@dataclass(frozen=True)
class Outcome:
    """What to print and how to exit.

    Attributes:
        text: for people, on stdout.
        document: for machines, on stdout instead, with ``--json``.
        exit_code: 0 done; 1 a cell failed.
    """

    text: str
    document: dict[str, Any]
    exit_code: int = 0
