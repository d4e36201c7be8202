"""The peak of one block of work is its own: an earlier one's does not hang over it."""

from __future__ import annotations

import pytest

from bench import memory
from bench.memory import peak_memory

_MB = 1_000_000


def added(megabytes: int) -> float:
    """What a block that fills so much memory, and lets go of it, is said to have added."""
    with peak_memory() as measured:
        block = bytearray(megabytes * _MB)
        block[::4096] = b"\1" * len(block[::4096])
        del block
    if measured.peak_mb is None or measured.before_mb is None:
        pytest.skip("this system keeps no peak that can be set back")
    return measured.peak_mb - measured.before_mb


def test_each_block_has_its_own_peak() -> None:
    large, small = added(300), added(20)
    assert 290 < large < 400
    assert 15 < small < 120


def test_nothing_is_guessed_where_the_system_does_not_say(monkeypatch: pytest.MonkeyPatch, tmp_path: object) -> None:
    monkeypatch.setattr(memory, "_CLEAR", memory.Path("/nonexistent/clear_refs"))
    with peak_memory() as measured:
        pass
    assert measured.to_json() == {"before_mb": None, "peak_mb": None}


def test_a_failure_inside_is_not_hidden() -> None:
    with pytest.raises(ZeroDivisionError), peak_memory() as measured:
        raise ZeroDivisionError
    assert (measured.before_mb is None) == (measured.peak_mb is None)
