"""A seal on a JSON document: two hashes over its own content, so that an edited number is found."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

__all__ = ["broken_seals", "digest", "is_sealed", "sealed", "unsealed"]

# What no two runs share. It is hashed apart, inside the timing block, so that the rest of two runs can be equal.
_VOLATILE = ("timing", "host")
_SEAL = "digest"


def digest(document: Any) -> str:
    """SHA-256 of plain JSON data: keys in order, no spaces, so neither layout nor insertion order matters."""
    text = json.dumps(document, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def sealed(document: Mapping[str, Any]) -> dict[str, Any]:
    """The document with ``digest`` over all but timing and host, and ``timing.digest`` over those two."""
    plain = unsealed(document)
    timing = {**plain.get("timing", {}), _SEAL: digest(_volatile(plain))}
    return {**plain, "timing": timing, _SEAL: digest(_lasting(plain))}


def unsealed(document: Mapping[str, Any]) -> dict[str, Any]:
    """The document without its two hashes."""
    plain = {key: value for key, value in document.items() if key != _SEAL}
    if isinstance(plain.get("timing"), Mapping):
        plain["timing"] = {key: value for key, value in plain["timing"].items() if key != _SEAL}
    return plain


def is_sealed(document: Mapping[str, Any]) -> bool:
    """True if the document carries a hash; files of schema version 1 do not."""
    return _SEAL in document


def broken_seals(document: Mapping[str, Any]) -> tuple[str, ...]:
    """Which parts are not as they were written: "content", "timing or host"; empty when all is well."""
    plain = unsealed(document)
    timing = document.get("timing")
    kept = timing.get(_SEAL) if isinstance(timing, Mapping) else None
    checks = (
        ("content", document.get(_SEAL), _lasting(plain)),
        ("timing or host", kept, _volatile(plain)),
    )
    return tuple(part for part, written, now in checks if not _is_digest(written, now))


def _is_digest(written: Any, document: Mapping[str, Any]) -> bool:
    """Nothing that was sealed holds NaN, half of a character or endless nesting: of such a document there is none."""
    try:
        return bool(written == digest(document))
    except (ValueError, RecursionError):
        return False


def _lasting(plain: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in plain.items() if key not in _VOLATILE}


def _volatile(plain: Mapping[str, Any]) -> dict[str, Any]:
    return {key: plain.get(key) or {} for key in _VOLATILE}
