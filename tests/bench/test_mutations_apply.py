"""The mutation check must not rot: every fault still finds its place, and names tests that exist."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from tests.mutations.fault import Fault, faulty_text
from tests.mutations.tsed_faults import TSED_FAULTS

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("fault", TSED_FAULTS, ids=lambda fault: fault.name)
def test_a_fault_finds_its_place_and_is_python(fault: Fault) -> None:
    text = faulty_text(fault, ROOT)
    assert text != (ROOT / fault.path).read_text(encoding="utf-8")
    ast.parse(text)
    assert fault.tests
    assert all((ROOT / test).is_file() for test in fault.tests)


def test_names_are_unique() -> None:
    names = [fault.name for fault in TSED_FAULTS]
    assert len(names) == len(set(names)) >= 50


def test_a_fault_without_its_place_is_refused() -> None:
    with pytest.raises(ValueError, match="0 times"):
        faulty_text(Fault("gone", "bench/metrics/sift.py", "no such text", "", ()), ROOT)
