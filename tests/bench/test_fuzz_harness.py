"""What counts the time of fuzzing: computing after start-up, stopped while a file says so; and the table made of it."""

from __future__ import annotations

import json
import sys
import threading
from pathlib import Path

import pytest

from tests.fuzz.report import read_log, write_report
from tests.fuzz.supervise import artifact_repeats, cpu_seconds_of, supervise
from tests.fuzz.targets import TARGETS

# An engine: computes for a while, says that it is ready, computes until it is told to end.
_ENGINE = """
import signal, sys, time
def end(number, frame):
    print("stat::number_of_executed_units: 42")
    sys.exit(0)
signal.signal(signal.SIGUSR1, end)
while time.process_time() < 0.3:
    pass
print(f"ready: {time.process_time():.2f}", flush=True)
print("#7 NEW", flush=True)
while True:
    pass
"""


def test_computing_is_counted_after_start_up(tmp_path: Path) -> None:
    ended = supervise([sys.executable, "-c", _ENGINE], 0.2, tmp_path / "log")
    start_up = float((tmp_path / "log").read_text().partition("ready: ")[2].split()[0])
    assert start_up >= 0.3
    assert ended.cpu_seconds >= 0.2
    assert (ended.executions, ended.crashed) == (42, False)


@pytest.mark.parametrize(("script", "executions"), [("raise SystemExit(77)", 0), ("print('#9 NEW'); 1 / 0", 9)])
def test_an_engine_that_ends_by_itself_has_crashed(tmp_path: Path, script: str, executions: int) -> None:
    ended = supervise([sys.executable, "-c", script], 100, tmp_path / "log")
    assert (ended.executions, ended.crashed, ended.cpu_seconds) == (executions, True, 0.0)


def test_it_is_stopped_while_the_file_is_there(tmp_path: Path) -> None:
    pause, seen = tmp_path / "pause", threading.Event()
    script = f"import os; open({str(tmp_path / 'pid')!r}, 'w').write(str(os.getpid()))\n{_ENGINE}"
    pause.touch()

    def watch() -> None:
        while not seen.is_set():
            try:
                pid = (tmp_path / "pid").read_text()
                state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
            except (OSError, IndexError):
                continue
            if state == "T":
                seen.set()
        pause.unlink()

    watching = threading.Thread(target=watch, daemon=True)
    watching.start()
    ended = supervise([sys.executable, "-c", script], 0.2, tmp_path / "log", pause)
    assert seen.is_set()
    assert not ended.crashed


def test_time_of_a_process_that_is_gone_is_what_was_known() -> None:
    assert cpu_seconds_of(2**22 + 1, 3.5) == 3.5


def test_an_input_that_is_no_hang_is_none(tmp_path: Path) -> None:
    pytest.importorskip("atheris")
    (tmp_path / "crash-timeout-1").write_bytes(b"2/8")
    assert not artifact_repeats("options", tmp_path / "crash-timeout-1")


def test_the_table_is_made_of_the_log(tmp_path: Path) -> None:
    log = tmp_path / "runs.jsonl"
    piece = {"target": "spec", "seconds": 90, "cpu_seconds": 60.0, "executions": 1000, "findings": ["crash-oom-1"]}
    other = {**piece, "findings": ["crash-oom-2", "KeyError-spec-1-abcdef"], "executions": 234}
    log.write_text(f"{json.dumps(piece)}\n{json.dumps(other)}\n")
    assert len(read_log(log)) == 2
    text = write_report(log, tmp_path).read_text()
    assert "| spec | `parse_external`, `parse_depth_spec` | 2.0 | 3.0 | 1,234 | 2 |" in text
    assert "| all | | 2.0 | 3.0 | 1,234 | |" in text
    assert text.count("| 0.0 | 0.0 | 0 | 0 |") == len(TARGETS) - 1
    assert f"0 of {len(TARGETS)} targets have had ten minutes" in text
    log.write_text(f"{json.dumps({**piece, 'cpu_seconds': 600.0})}\n")
    assert f"1 of {len(TARGETS)} targets have had ten minutes" in write_report(log, tmp_path).read_text()
