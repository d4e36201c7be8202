"""TSED over the scenes of a data set: pooled pairs, mean over scenes, and how sure either can be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean

from bench.stats import wilson_interval
from orca.errors import BadInput

__all__ = ["PooledFraction", "pool_fractions"]


@dataclass(frozen=True)
class PooledFraction:
    """A fraction of consistent pairs over several scenes.

    Attributes:
        consistent: consistent pairs of all scenes.
        pairs: counted pairs of all scenes.
        scenes: number of scenes with at least one pair.
        pooled: consistent / pairs.
        mean: mean of the scenes' fractions; differs from ``pooled`` where scenes have unequal numbers of pairs.
        low, high: Wilson interval of ``pooled``. Pairs of one scene are not independent: read it as a lower bound of
            the uncertainty.
    """

    consistent: int
    pairs: int
    scenes: int
    pooled: float
    mean: float
    low: float
    high: float


def pool_fractions(counts: Sequence[tuple[int, int]], confidence: float = 0.95) -> PooledFraction:
    """Pool (consistent, pairs) counts, one a scene; scenes without a pair are left out.

    Raises `BadInput` if no scene has a pair, or a count is impossible.
    """
    kept = [(consistent, pairs) for consistent, pairs in counts if pairs > 0]
    if not kept or any(not 0 <= consistent <= pairs for consistent, pairs in kept):
        raise BadInput(
            f"TSED counts {list(counts)}", "0 <= consistent <= pairs, at least one scene with pairs", "check the scores"
        )
    consistent, pairs = sum(c for c, _ in kept), sum(p for _, p in kept)
    low, high = wilson_interval(consistent, pairs, confidence)
    return PooledFraction(consistent, pairs, len(kept), consistent / pairs, fmean(c / p for c, p in kept), low, high)
