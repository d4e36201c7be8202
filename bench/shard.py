"""One of n parts of a data set's scenes: disjoint, complete, and the same wherever it is asked for."""

from __future__ import annotations

import re
from collections.abc import Sequence

from orca.errors import BadInput

__all__ = ["parse_shard", "scenes_of_shard"]


def parse_shard(text: str) -> tuple[int, int]:
    """``"2/8"`` -> (2, 8). Raises `BadInput` unless 1 <= i <= n."""
    found = re.fullmatch(r"(\d{1,9})/(\d{1,9})", text.strip())
    if found is None or not 1 <= int(found[1]) <= int(found[2]):
        raise BadInput(f"--shard {text}", "I/N with 1 <= I <= N", "the first of eight parts: --shard 1/8")
    return int(found[1]), int(found[2])


def scenes_of_shard(scenes: Sequence[str], known: Sequence[str], shard: tuple[int, int]) -> tuple[str, ...]:
    """Those of the scenes that belong to part i of n.

    The k-th scene of the data set belongs to part k mod n + 1: parts of the whole differ by one scene at most, and
    which part a scene belongs to does not depend on the scenes that are asked for.

    Args:
        scenes: those asked for.
        known: all of the data set, in its order.
        shard: (i, n).
    """
    part, parts = shard
    mine = {scene for position, scene in enumerate(known) if position % parts == part - 1}
    return tuple(scene for scene in scenes if scene in mine)
