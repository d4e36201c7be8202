"""A run's folder that somebody else changed: checking, merging and reading it fail by name, in no other way."""

from __future__ import annotations

import json
from typing import Any

import pytest

from bench.digest import broken_seals, unsealed
from tests.fuzz.targets import TARGETS, refused_or_read, sound_run

RUN, RECORD, CURVES = 0, 1, 4  # which file of `sound_run`
REFUSED = [
    (RUN, "identity", None),
    (RUN, "identity.seed", float("nan")),
    (RUN, "identity.images", 3),
    (RUN, "timing", 5),
    (RUN, "folders", "x"),
    (RUN, "folders.data_root", ["x"]),
    (RUN, "metrics", [["bright"]]),
    (RECORD, "inputs.files", ["a"]),
    (RECORD, "frames.0.index", []),
    (RECORD, "timing.metrics", {"Bright": [1.0]}),
    (RECORD, "trajectory_sha256", 5),
    (CURVES, "rows.0.disturbance", "no such thing"),
    (CURVES, "rows.0.level", "much"),
    (CURVES, "rows.0.level", 10**400),
]


def changed(which: int, path: str, value: Any) -> bytes:
    """A file of a sound run without its seal, one of its parts replaced, as the target takes it."""
    document = unsealed(json.loads(sound_run()[which][1]))
    *way, last = [int(key) if key.isdecimal() else key for key in path.split(".")]
    part: Any = document
    for key in way:
        part = part[key]
    part[last] = value
    return bytes([which]) + json.dumps(document).encode()


def test_the_sound_run_is_read() -> None:
    for which, (_, content) in enumerate(sound_run()):
        assert refused_or_read(TARGETS["run"], bytes([which]) + content) == "read"


@pytest.mark.parametrize(("which", "path", "value"), REFUSED, ids=lambda value: str(value)[:20])
def test_parts_of_other_types_are_refused(which: int, path: str, value: Any) -> None:
    assert refused_or_read(TARGETS["run"], changed(which, path, value)) == "bad_input"


@pytest.mark.parametrize("name", ["../../run", "a" * 5000, "\0"])
def test_cameras_are_looked_for_under_a_hash_only(name: str) -> None:
    assert refused_or_read(TARGETS["run"], changed(RECORD, "trajectory_sha256", name)) in ("read", "bad_input")


def test_what_cannot_be_hashed_was_not_sealed() -> None:
    deep: list[Any] = []
    for _ in range(100_000):
        deep = [deep]
    for value in (float("nan"), "\ud800", deep):
        assert broken_seals({"part": value, "digest": "0" * 64}) == ("content", "timing or host")
