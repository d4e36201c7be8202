"""The one family of errors a user may meet: each says what was given, what is allowed and what to do."""

from __future__ import annotations

__all__ = ["BadInput", "CannotWrite", "OrcaError", "TimedOut", "Unavailable", "Unknown"]


class OrcaError(Exception):
    """Base of every expected error; the command lines print it as three lines, without a traceback.

    Args:
        given: what was found.
        allowed: what would have been accepted.
        fix: what the reader can do about it.
    """

    kind = "error"

    def __init__(self, given: str, allowed: str, fix: str) -> None:
        self.given, self.allowed, self.fix = given, allowed, fix
        super().__init__(f"{given}\n  allowed: {allowed}\n  to do:   {fix}")

    def __reduce__(self) -> tuple[type[OrcaError], tuple[str, str, str]]:
        return type(self), (self.given, self.allowed, self.fix)


class BadInput(OrcaError, ValueError):
    """The input itself is wrong: a missing or broken file, a wrong shape, a value out of range."""

    kind = "bad_input"


class CannotWrite(BadInput):
    """The place for results is full, read-only or gone: that ends a run, and says nothing of a method."""

    kind = "cannot_write"


class Unknown(BadInput):
    """A name that no registry knows."""

    kind = "unknown_name"


class Unavailable(OrcaError):
    """Something optional is not here: weights, a package, a data set. Says which file goes where."""

    kind = "unavailable"


class TimedOut(OrcaError):
    """Something took longer than it was given."""

    kind = "timed_out"
