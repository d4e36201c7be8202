"""One process of Atheris: ``python -m tests.fuzz.engine TARGET FINDINGS [libFuzzer's options] CORPUS...``.

A Python exception is written down under its kind and place, once, and the fuzzing goes on; only a crash of compiled
code, a time-out, or too much memory ends the process.
"""

from __future__ import annotations

import hashlib
import logging
import os
import sys
import traceback
import warnings
from pathlib import Path

import atheris

from tests.fuzz.mutate import mutated_json

_OURS = ("orca", "bench", "tests.fuzz.targets", "tests.fuzz.targets_metrics")
with atheris.instrument_imports(include=[*_OURS, "zipfile", "tarfile", "pickletools"]):
    from tests.fuzz.targets import TARGETS, refused_or_read


def main() -> None:
    """Fuzz until libFuzzer ends the process."""
    target, findings = TARGETS[sys.argv[1]], Path(sys.argv[2])
    logging.disable(logging.CRITICAL)
    warnings.simplefilter("ignore")
    sound = [path.read_bytes() for place in sys.argv[3:] for path in sorted(Path(place).glob("seed-*"))]
    with atheris.instrument_imports(include=[*_OURS, "PIL", *target.instrument]):  # readers import when called
        for content in (b"", *sound):
            try:
                refused_or_read(target, content)
            except Exception as error:  # noqa: BLE001 - whatever it is, it is a finding
                _keep(findings, content, error)
    print(f"ready: {sum(os.times()[:4]):.2f}", file=sys.stderr, flush=True)  # what was computed so far is start-up

    def one(content: bytes) -> None:
        try:
            refused_or_read(target, content)
        except Exception as error:  # noqa: BLE001 - whatever it is, it is a finding
            _keep(findings, content, error)

    def mutated(content: bytes, size: int, seed: int) -> bytes:
        mark, body = (content[:1], content[1:]) if target.marked else (b"", content)
        changed = mutated_json(body, size - len(mark), seed) if seed % 4 else None
        return atheris.Mutate(content, size) if changed is None else mark + changed

    custom = {"custom_mutator": mutated} if target.json else {}
    atheris.Setup([sys.argv[0], *sys.argv[3:]], one, **custom)
    atheris.Fuzz()


def _keep(findings: Path, content: bytes, error: Exception) -> None:
    """Write an input down if no other gave this kind of error at this place."""
    frame = traceback.extract_tb(error.__traceback__)[-1]
    ours = [f for f in traceback.extract_tb(error.__traceback__) if "/orca/" in f.filename or "/bench/" in f.filename]
    place = ours[-1] if ours else frame
    key = f"{type(error).__name__}-{Path(place.filename).stem}-{place.lineno}"
    path = findings / f"{key}-{hashlib.sha256(key.encode()).hexdigest()[:6]}"
    if not path.exists():
        path.write_bytes(content)
        path.with_suffix(".txt").write_text("".join(traceback.format_exception(error)))


if __name__ == "__main__":
    main()
