"""The other end of a local worker: a process that is handed one scene at a time."""

from __future__ import annotations

import logging
import os
import pickle
import signal
import sys
import time
import traceback
from multiprocessing.connection import Connection

from bench.processes import end_with_parent
from bench.progress import SilentReporter
from bench.scenework import SceneWork, opened

__all__ = ["serve"]


class _Telling(SilentReporter):
    """Sends what a run says to the process that shows it; of a fit's thousands of steps, five a second."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._sent = 0.0

    def phase(self, scene: str, method: str, phase: str, done: int, total: int) -> None:
        now = time.monotonic()
        if 0 < done < total and now - self._sent < 0.2:
            return
        self._sent = now
        self._connection.send(("phase", (scene, method, phase, done, total)))

    def cell(self, line: str | None) -> None:
        self._connection.send(("cell", line))


def serve(connection: Connection, work: SceneWork, threads: int, log_level: int) -> None:
    """Finish the scenes that come, until None or the end of the line; never returns what it computed, only how it went.

    Args:
        connection: gets (scene, again) or None; gives ("ready", None) once, then ("phase", ...), ("cell", line), and
            ("done", SceneOutcome) or ("error", exception) for each scene.
        work: what to do.
        threads: that OpenCV may use; numba, torch and BLAS were told by the environment.
        log_level: of the loggers of bench.
    """
    _settle(threads, log_level)
    telling = _Telling(connection)
    try:
        connection.send(("ready", None))
        while (task := connection.recv()) is not None:
            scene, again = task
            try:
                connection.send(("done", opened(work).finish(scene, telling, again)))
            except BrokenPipeError:
                raise
            except Exception as error:  # noqa: BLE001 - sent whole, and raised where the run was started
                connection.send(("error", _portable(error)))
    except (EOFError, BrokenPipeError):  # the other end is gone: nobody waits
        return


def _settle(threads: int, log_level: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the first process decides
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))  # unfinished files are dropped
    os.dup2(sys.stderr.fileno(), 1)  # stdout belongs to the document of --json
    logging.basicConfig(stream=sys.stderr, level=logging.WARNING, format="%(levelname)s %(name)s: %(message)s")
    logging.getLogger("bench").setLevel(log_level)
    end_with_parent()
    import cv2

    cv2.setNumThreads(threads)


def _portable(error: Exception) -> Exception:
    """The error if it survives pickling, else its traceback in words."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # noqa: BLE001 - whatever a foreign exception does when it is pickled
        return RuntimeError("".join(traceback.format_exception(error)))
    return error
