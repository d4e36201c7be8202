"""What is known of processes: their memory, and children that end with their parent."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest

from bench.processes import memory_mb

LINUX = pytest.mark.skipif(not Path("/proc/self/status").is_file(), reason="the system does not say")

ROOT = str(Path(__file__).resolve().parents[2])

MEMORY = """
import sys
sys.path.insert(0, sys.argv[1])
from bench.processes import memory_mb

before = memory_mb()
taken = bytearray(b"1") * 64_000_000
with_it = memory_mb()
del taken
print(before, with_it, memory_mb(), memory_mb("VmHWM"))
"""

PARENT = """
import multiprocessing, sys, time
sys.path.insert(0, sys.argv[1])
from bench.processes import end_with_parent

def child(line):
    end_with_parent()
    line.send(multiprocessing.current_process().pid)
    time.sleep(600)

if __name__ == "__main__":
    ours, theirs = multiprocessing.get_context("fork").Pipe()
    process = multiprocessing.get_context("fork").Process(target=child, args=(theirs,))
    process.start()
    print(ours.recv(), flush=True)
    time.sleep(600)
"""


@LINUX
def test_memory_grows_by_what_is_taken_and_the_peak_stays() -> None:
    """In a process of its own: the system takes idle pages from a large one while it counts."""
    counted = subprocess.run([sys.executable, "-c", MEMORY, ROOT], capture_output=True, text=True, check=True)
    before, with_it, after, peak = map(float, counted.stdout.split())
    assert 50 < with_it - before < 80
    assert after - before < 30
    assert abs(peak - with_it) < 10  # the kernel counts pages in batches: they may differ by a few


def test_a_process_that_is_gone_and_a_field_that_is_not_there_have_none() -> None:
    assert memory_mb(process=2**22 + 1) is None
    assert memory_mb("VmNothing") is None


@LINUX
def test_a_child_ends_when_its_parent_is_killed(tmp_path: Path) -> None:
    script = tmp_path / "parent.py"
    script.write_text(PARENT)
    parent = subprocess.Popen([sys.executable, str(script), ROOT], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    child = Path("/proc") / parent.stdout.readline().strip()
    assert child.is_dir()
    parent.kill()
    parent.wait()
    end = time.monotonic() + 60
    while child.is_dir() and "\nState:\tZ" not in child.joinpath("status").read_text():
        assert time.monotonic() < end, "it lives on"
        time.sleep(0.05)
