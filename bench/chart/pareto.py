"""The Pareto front: what nothing else beats on cost and quality at once."""

from __future__ import annotations

from collections.abc import Sequence

__all__ = ["beaten_by", "pareto_front"]


def pareto_front(costs: Sequence[float], qualities: Sequence[float], higher_is_better: bool = True) -> tuple[int, ...]:
    """Indices of the points that no other beats, cheapest first.

    A point is beaten by one that costs no more and is no worse, and is strictly better in one of the two. Two equal
    points do not beat one another.
    """
    kept = [i for i in range(len(costs)) if not beaten_by(i, costs, qualities, higher_is_better)]
    sign = -1 if higher_is_better else 1
    return tuple(sorted(kept, key=lambda i: (costs[i], sign * qualities[i], i)))


def beaten_by(
    index: int, costs: Sequence[float], qualities: Sequence[float], higher_is_better: bool = True
) -> tuple[int, ...]:
    """Indices of the points that beat the given one."""
    sign = 1 if higher_is_better else -1
    cost, quality = costs[index], sign * qualities[index]
    return tuple(
        j
        for j in range(len(costs))
        if costs[j] <= cost and sign * qualities[j] >= quality and (costs[j] < cost or sign * qualities[j] > quality)
    )
