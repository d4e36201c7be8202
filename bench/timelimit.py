"""A limit on the time that one step may take: Python code is interrupted, compiled code that never returns is left."""

from __future__ import annotations

import logging
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from orca.errors import TimedOut

__all__ = ["EXIT_CODE", "GRACE_S", "time_limit"]

EXIT_CODE = 75  # EX_TEMPFAIL of sysexits.h: the same command goes on from here
GRACE_S = 10.0  # how long after its limit a step may still take to come back from compiled code

_log = logging.getLogger(__name__)


class _Expired(BaseException):
    """Not an Exception: a library that survives every error must not survive this one."""


@contextmanager
def time_limit(seconds: float | None, what: str, stuck: Callable[[TimedOut], None]) -> Iterator[None]:
    """Raise `TimedOut` in the block when it takes longer than ``seconds``.

    The signal that does so is seen when compiled code returns. A block that has not come back `GRACE_S` later is given
    up: ``stuck`` is called from another thread to write down what happened, and the process ends with `EXIT_CODE`. Code
    that never returns and never lets another thread run can only be killed from outside.

    Args:
        seconds: the limit, more than 0; None for none.
        what: the step, for the message.
        stuck: records the failure of a block that does not come back; the process ends after it.

    Raises:
        TimedOut: the block took longer.
    """
    if seconds is None:
        yield
        return
    if threading.current_thread() is not threading.main_thread():  # only there Python handles signals
        _log.warning("no time limit on %s: it does not run in the main thread", what)
        yield
        return
    error = TimedOut(
        f"{what} took longer than {seconds:g} s", f"--cell-timeout {seconds:g}", "raise it and add --retry-failed"
    )
    watch = threading.Timer(seconds + GRACE_S, _give_up, (error, stuck))
    watch.daemon = True
    before = signal.signal(signal.SIGALRM, _expire)
    try:
        watch.start()
        signal.setitimer(signal.ITIMER_REAL, seconds, GRACE_S / 2)  # again, should a first one have been swallowed
        yield
    except _Expired:
        raise error from None
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
        watch.cancel()


def _expire(number: int, frame: object) -> None:
    raise _Expired


def _give_up(error: TimedOut, stuck: Callable[[TimedOut], None]) -> None:
    try:
        stuck(error)
        _log.error("%s, and does not come back: this process ends; the same command goes on from here", error.given)
    finally:
        os._exit(EXIT_CODE)
