"""Every parser on what fuzzing found and on changed sound files: read, or refused by a typed error."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.fuzz.mutate import mutated_json
from tests.fuzz.seeds import seeds
from tests.fuzz.targets import TARGETS, refused_or_read

CORPUS = Path(__file__).resolve().parents[1] / "fuzz" / "corpus"
KEPT = sorted(path for path in CORPUS.rglob("*") if path.is_file())
QUICK = settings(
    max_examples=40,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
# A network is tried in a process of its own, which takes a second; the corpus has those that crashed.
BYTES = [name for name in TARGETS if name != "onnx"]


@pytest.mark.parametrize("path", KEPT, ids=lambda path: f"{path.parent.name}-{path.name}")
def test_what_was_found_once(path: Path) -> None:
    assert refused_or_read(TARGETS[path.parent.name], path.read_bytes()) is not None


def test_the_corpus_is_small() -> None:
    assert sum(path.stat().st_size for path in KEPT) < 100_000
    assert {path.parent.name for path in KEPT} <= set(TARGETS)


@pytest.mark.parametrize("name", TARGETS)
def test_sound_files_are_read(name: str) -> None:
    """At least one seed of a target gets through all of its readers, so that fuzzing starts behind the first check."""
    found = [refused_or_read(TARGETS[name], content) for content in seeds(name)]
    if name in ("record", "tables", "spec", "weights", "options"):  # several readers share their inputs
        assert found
    else:
        assert "read" in found


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.slow] if name == "scene" else [])
        for name, target in TARGETS.items()
        if target.json
    ],
)
def test_changed_documents(name: str) -> None:
    documents = [content for content in seeds(name) if content[:1] != b"\1"]

    @QUICK
    @given(st.integers(0, len(documents) - 1), st.integers(0, 2**32))
    def holds(which: int, seed: int) -> None:
        marked = TARGETS[name].marked
        mark, body = (documents[which][:1], documents[which][1:]) if marked else (b"", documents[which])
        changed = mutated_json(body, 1 << 16, seed)
        if changed is not None:
            assert refused_or_read(TARGETS[name], mark + changed) is not None

    holds()


@pytest.mark.parametrize("name", BYTES)
def test_changed_bytes(name: str) -> None:
    """Bytes overwritten, cut out, and the end cut off."""
    files = list(seeds(name))

    @QUICK
    @given(st.integers(0, len(files) - 1), st.integers(0, 2**32), st.floats(0, 1))
    def holds(which: int, seed: int, cut: float) -> None:
        rng, content = random.Random(seed), bytearray(files[which])
        for _ in range(rng.randint(1, 8)):
            at = rng.randrange(len(content))
            content[at : at + rng.choice((0, 1, 1, 1, 4))] = rng.randbytes(rng.choice((0, 1, 1, 4)))
            content = content or bytearray(b"\0")
        if cut > 0.7:
            content = content[: int(len(content) * cut)]
        assert refused_or_read(TARGETS[name], bytes(content)) is not None

    holds()
