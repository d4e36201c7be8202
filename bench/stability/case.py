"""A stability case: an input or a circumstance, and what may become of a method on it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from bench.adapters.adapter import MethodOutput
from bench.datasets.case import SceneCase
from bench.stability.outcome import HONEST

if TYPE_CHECKING:
    from orca.priors.choose import Priors

__all__ = ["ORCA", "StabilityCase"]

ORCA = "orca"


@dataclass(frozen=True)
class StabilityCase:
    """One row of the matrix. Exactly one of ``scene`` and ``command`` is set.

    Attributes:
        name: what tables and the command line call it.
        group: which kind of case it is.
        about: the input, in one line.
        expected: outcomes that are as they should be, for ORCA.
        others: ... and for every other method.
        scene: makes the input, given an empty folder; may raise what reading it raises.
        command: arguments of ``orca reconstruct`` for the same, without ``--out``; such a case is ORCA's alone.
        priors: replaces who completes what the image does not show; such a case is ORCA's alone.
        check: what is wrong with a finished output beyond `bench.stability.outcome.judge`, in words, or None.
        around: circumstances under which the method runs (a small disk, little memory).
        needs: a scene of a data set that must be here, as "DATASET/SCENE"; without it the case is left out.
    """

    name: str
    group: str
    about: str
    expected: tuple[str, ...]
    others: tuple[str, ...] = HONEST
    scene: Callable[[Path], SceneCase] | None = None
    command: Callable[[Path], list[str]] | None = None
    priors: Callable[[Priors], Priors] | None = None
    check: Callable[[SceneCase, MethodOutput], str | None] | None = None
    around: Callable[[], AbstractContextManager[None]] = nullcontext
    needs: str | None = None

    def takes(self, method: str) -> bool:
        """Whether a method can be asked: what goes through ORCA's own interfaces is asked of ORCA only."""
        return method == ORCA or (self.command is None and self.priors is None)

    def allowed(self, method: str) -> tuple[str, ...]:
        """The expected outcomes of a method; ORCA's variants answer as ORCA does."""
        return self.expected if method.partition("-")[0] == ORCA else self.others
