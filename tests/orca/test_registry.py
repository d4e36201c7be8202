"""Lazy names, "did you mean", and errors that survive a process boundary."""

from __future__ import annotations

import pickle
import sys

import pytest

from orca.errors import BadInput, OrcaError, Unavailable, Unknown
from orca.registry import Registry


@pytest.fixture
def registry() -> Registry[object]:
    return Registry("codec", {"colour": "colorsys:rgb_to_hsv", "wave": "no_such_module_anywhere:Wave"})


def test_targets_are_imported_when_used(registry: Registry[object], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "colorsys", raising=False)
    assert list(registry) == ["colour", "wave"]
    assert "wave" in registry
    assert "tune" not in registry
    assert registry.check("wave") == "wave"
    assert "colorsys" not in sys.modules
    function = registry.get("colour")
    assert function is sys.modules["colorsys"].rgb_to_hsv


def test_a_broken_target_fails_when_used(registry: Registry[object]) -> None:
    with pytest.raises(ModuleNotFoundError, match="no_such_module_anywhere"):
        registry.get("wave")


@pytest.mark.parametrize("access", ["check", "get"])
def test_a_near_miss_is_met_with_the_nearest_name(registry: Registry[object], access: str) -> None:
    with pytest.raises(Unknown) as caught:
        getattr(registry, access)("color")
    assert caught.value.given == "unknown codec 'color'"
    assert caught.value.allowed == "colour, wave"
    assert caught.value.fix == "did you mean 'colour'?"


def test_a_far_miss_is_met_with_the_list(registry: Registry[object]) -> None:
    with pytest.raises(Unknown, match="choose one codec of the list"):
        registry.get("zzzz")


def test_the_registry_does_not_follow_later_changes_of_the_table() -> None:
    table = {"a": "math:pi"}
    registry: Registry[float] = Registry("constant", table)
    table["b"] = "math:e"
    assert list(registry) == ["a"]


@pytest.mark.parametrize("kind", [OrcaError, BadInput, Unknown, Unavailable])
@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_errors_survive_pickling(kind: type[OrcaError], protocol: int) -> None:
    error = kind("a three-legged chair", "four legs", "find the fourth")
    again = pickle.loads(pickle.dumps(error, protocol))
    assert type(again) is kind
    assert (again.given, again.allowed, again.fix) == ("a three-legged chair", "four legs", "find the fourth")
    assert str(again) == str(error)


def test_errors_say_three_things_in_three_lines() -> None:
    lines = str(BadInput("this", "that", "do so")).splitlines()
    assert [line.split(":")[-1].strip() for line in lines] == ["this", "that", "do so"]


def test_the_family_of_errors() -> None:
    assert issubclass(BadInput, ValueError)
    assert issubclass(Unknown, BadInput)
    assert not issubclass(Unavailable, ValueError)
    kinds = [e.kind for e in (OrcaError, BadInput, Unknown, Unavailable)]
    assert kinds == ["error", "bad_input", "unknown_name", "unavailable"]
