"""The mutation check: every fault in a copy of the code, its tests run, and a table of which were caught.

    python -m tests.mutations                all faults; exit code 1 if one survives
    python -m tests.mutations zero baseline  those whose name holds these words

Your checkout is only read.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.mutations.fault import Fault, faulty_text
from tests.mutations.tsed_faults import TSED_FAULTS

ROOT = Path(__file__).resolve().parents[2]
COPIED = ("bench", "orca", "tests", "pyproject.toml")
LIMIT_S = 1200.0
ALL_PASS, SOME_FAIL, INTERRUPTED = 0, 1, 2


@dataclass(frozen=True)
class Outcome:
    """What the tests said to one fault.

    Attributes:
        caught: True if a test failed.
        by: the first test that failed, or why there is none.
        seconds: wall time.
    """

    caught: bool
    by: str
    seconds: float


def main(argv: Sequence[str] | None = None) -> int:
    """Run the check; return 0 if every fault is caught."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutations", description="Does the suite notice faults?")
    parser.add_argument("words", nargs="*", help="only faults whose name holds these words")
    words = " ".join(parser.parse_args(argv).words)
    faults = [fault for fault in TSED_FAULTS if words in fault.name]
    if not faults:
        print(f"no fault is named like '{words}'")
        return 2
    with tempfile.TemporaryDirectory() as folder:
        copy = copy_of_the_code(Path(folder))
        tests = tuple(dict.fromkeys(test for fault in faults for test in fault.tests))
        clean = run_tests(copy, tests)
        if clean.caught:
            print(f"the tests fail without any fault: {clean.by}")
            return 2
        survivors = [fault for fault in faults if not check(fault, copy).caught]
    print(f"{len(faults) - len(survivors)} of {len(faults)} faults caught")
    for fault in survivors:
        print(f"SURVIVED: {fault.name} ({fault.path})")
    return 1 if survivors else 0


def copy_of_the_code(folder: Path) -> Path:
    """Copy what the tests need, without compiled files."""
    for name in COPIED:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, folder / name, ignore=shutil.ignore_patterns("__pycache__", "*.nbi", "*.nbc"))
        else:
            shutil.copy(source, folder / name)
    return folder


def check(fault: Fault, copy: Path) -> Outcome:
    """Put one fault in, run its tests, take it out again, and print a line."""
    path = copy / fault.path
    right = path.read_text(encoding="utf-8")
    path.write_text(faulty_text(fault, copy), encoding="utf-8")
    try:
        outcome = run_tests(copy, fault.tests)
    finally:
        path.write_text(right, encoding="utf-8")
    verdict = "caught  " if outcome.caught else "SURVIVED"
    print(f"{verdict}  {fault.name:48}  {outcome.seconds:6.1f} s  {outcome.by}", flush=True)
    return outcome


def run_tests(copy: Path, tests: Sequence[str]) -> Outcome:
    """Run test files until the first failure; anything but "all pass" and "some fail" is an error of the check."""
    # No compiled files: Python tells a changed source by its size and second, which a quick edit may keep.
    command = [sys.executable, "-B", "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "--tb=no", *tests]
    started = time.perf_counter()
    environment = {**os.environ, "PYTHONPATH": str(copy)}
    try:
        done = subprocess.run(
            command, cwd=copy, env=environment, capture_output=True, text=True, check=False, timeout=LIMIT_S
        )
    except subprocess.TimeoutExpired:
        return Outcome(True, f"no end within {LIMIT_S:.0f} s", LIMIT_S)
    seconds = time.perf_counter() - started
    if done.returncode not in (ALL_PASS, SOME_FAIL, INTERRUPTED):
        raise RuntimeError(f"pytest exited with {done.returncode}:\n{done.stdout}\n{done.stderr}")
    named = [line for line in done.stdout.splitlines() if line.startswith(("FAILED ", "ERROR "))]
    first = named[0].split(" - ")[0].partition("tests/bench/")[2] if named else "no test failed"
    return Outcome(done.returncode != ALL_PASS, first, seconds)


if __name__ == "__main__":
    sys.exit(main())
