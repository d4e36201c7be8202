"""Changes JSON as JSON: bytes flipped in a document almost never parse, and say nothing about what lies behind."""

from __future__ import annotations

import json
import random
from copy import deepcopy
from typing import Any

__all__ = ["mutated_json"]

_ODD: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 2, 0.5, 1e308, -1e-320, 10**30, 2**31, 2**63, 1 << 80),
    *(float("nan"), float("inf"), float("-inf"), "", "x", "inf", "\0", "é" * 9, "../a", "1e5", "NaN"),
    *([], {}, [[]], [1, 2, 3], [None], {"": None}, [[1, 0], [0]], "a" * 300),
)


def mutated_json(content: bytes, size: int, seed: int) -> bytes | None:
    """The document with one to three of its parts replaced, doubled or left out; None if it is no JSON."""
    try:
        document = json.loads(content)
    except (ValueError, RecursionError):
        return None
    rng = random.Random(seed)
    for _ in range(rng.randint(1, 3)):
        document = _changed(document, rng)
    out = json.dumps(document).encode()
    return out if len(out) <= size else None


def _changed(node: Any, rng: random.Random) -> Any:
    """Walk down at random and change what is there."""
    if not isinstance(node, dict | list) or not node or rng.random() < 0.15:
        return deepcopy(rng.choice(_ODD))
    key = rng.choice(list(node)) if isinstance(node, dict) else rng.randrange(len(node))
    act = rng.random()
    if act < 0.7:
        node[key] = _changed(node[key], rng)
    elif act < 0.8:
        del node[key]
    elif isinstance(node, list):
        node.insert(key, deepcopy(node[key]))  # a part that is there twice could come to hold itself
    else:
        node[rng.choice([*node, "x"])] = deepcopy(node[key])
    return node
