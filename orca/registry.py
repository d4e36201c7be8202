"""Names to objects, imported only when they are used."""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Iterator
from typing import Generic, TypeVar, cast

from orca.errors import Unknown

__all__ = ["Registry"]

T = TypeVar("T")


class Registry(Generic[T]):
    """A table of lazy ``"module:object"`` targets.

    Args:
        kind: what the names stand for, in the singular ("metric"); used in error messages.
        targets: name -> ``"package.module:attribute"``.
    """

    def __init__(self, kind: str, targets: dict[str, str]) -> None:
        self.kind = kind
        self._targets = dict(targets)

    def __iter__(self) -> Iterator[str]:
        return iter(self._targets)

    def __contains__(self, name: object) -> bool:
        return name in self._targets

    def check(self, name: str) -> str:
        """Return ``name`` if it is known; raise `Unknown` with the nearest names if not. Imports nothing."""
        if name not in self._targets:
            near = difflib.get_close_matches(name, self._targets, n=1, cutoff=0.5)
            fix = f"did you mean '{near[0]}'?" if near else f"choose one {self.kind} of the list"
            raise Unknown(f"unknown {self.kind} '{name}'", ", ".join(self._targets), fix)
        return name

    def get(self, name: str) -> T:
        """Import and return the object behind ``name``; raise `Unknown` for a wrong name."""
        module, _, attribute = self._targets[self.check(name)].partition(":")
        return cast(T, getattr(importlib.import_module(module), attribute))
