"""Whoever waits for kernels to be compiled is told."""

from __future__ import annotations

from typing import Any

import numba
import pytest

from orca.compilation import PHASE, told_of_compilation
from orca.errors import BadInput


def _kernel() -> Any:
    """A function that calls another."""

    @numba.njit  # type: ignore[untyped-decorator]
    def inner(x: float) -> float:
        return x + 1

    @numba.njit  # type: ignore[untyped-decorator]
    def outer(x: float) -> float:
        return inner(x) * 2

    return outer


def test_each_kernel_is_announced_once_with_what_it_calls() -> None:
    said: list[tuple[str, int, int]] = []
    outer, other = _kernel(), _kernel()
    with told_of_compilation(lambda *words: said.append(words)):
        assert outer(1.0) == 4.0
        assert outer(2.0) == 6.0
        assert other(1.0) == 4.0
    assert said == [(PHASE, 1, 1), (PHASE, 2, 2)]


def test_nothing_is_said_outside_the_block_or_of_compiled_kernels() -> None:
    said: list[tuple[str, int, int]] = []
    outer = _kernel()
    outer(1.0)
    with told_of_compilation(lambda *words: said.append(words)):
        outer(1.0)
    _kernel()(1.0)
    assert said == []


def test_an_error_inside_the_block_ends_the_listening() -> None:
    said: list[tuple[str, int, int]] = []
    with pytest.raises(BadInput), told_of_compilation(lambda *words: said.append(words)):
        raise BadInput("x", "y", "z")
    _kernel()(1.0)
    assert said == []
