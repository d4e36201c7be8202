"""Faults on demand at the points where files are written: how the tests show that nothing is lost there.

``ORCA_FAULT="ACTION STEP PATTERN [N]"`` in the environment strikes when STEP is reached for the N-th time (1) with a
file whose path matches PATTERN (shell style). ACTION is ``kill`` (SIGKILL to this process, as from the outside) or the
name of an errno, such as ``ENOSPC``, ``EROFS`` or ``EACCES``, that the step then fails with. Without the variable
nothing of this happens.
"""

from __future__ import annotations

import errno
import fnmatch
import os
import signal
from collections import Counter
from pathlib import Path

from orca.errors import BadInput

__all__ = ["STEPS", "VARIABLE", "fault_point"]

VARIABLE = "ORCA_FAULT"
# start: nothing of the file is there. made: an unfinished file is, empty. half: it holds half of its bytes.
# written: all of them. named: it has taken its name.
STEPS = ("start", "made", "half", "written", "named")
_reached: Counter[str] = Counter()


def fault_point(step: str, target: Path, unfinished: Path | None = None) -> None:
    """Strike if the environment asks for it here.

    Args:
        step: one of `STEPS`.
        target: the file that is being written.
        unfinished: where its bytes are until it takes its name; cut to half of them where "half" strikes.

    Raises:
        OSError: the error asked for.
        BadInput: a value of the variable that says nothing of the kind.
    """
    asked = os.environ.get(VARIABLE)
    if not asked:
        return
    action, at, pattern, count = _parsed(asked)
    if at != step or not fnmatch.fnmatch(str(target), pattern):
        return
    _reached[asked] += 1
    if _reached[asked] == count:
        if step == "half" and unfinished is not None:
            os.truncate(unfinished, unfinished.stat().st_size // 2)
        _strike(action)


def _parsed(asked: str) -> tuple[str, str, str, int]:
    words = asked.split()
    count = words[3] if len(words) == 4 else "1"
    known = len(words) in (3, 4) and words[1] in STEPS and count.isdecimal()
    if not known or not (words[0] == "kill" or hasattr(errno, words[0])):
        raise BadInput(
            f"{VARIABLE}='{asked}'", f"'kill or ENOSPC, {' or '.join(STEPS)}, a pattern, a count'", "unset it"
        )
    return words[0], words[1], words[2], int(count)


def _strike(action: str) -> None:
    if action == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    number = getattr(errno, action)
    raise OSError(number, os.strerror(number))
