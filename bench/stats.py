"""Means that say what they are means of, and intervals around them."""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist, fmean

from orca.errors import BadInput

__all__ = ["Mean", "PairedTest", "bootstrap_interval", "mean_of_present", "paired_test", "wilson_interval"]


_DRAWN_AT_A_TIME = 1_000_000


@dataclass(frozen=True)
class Mean:
    """A mean over scenes.

    Attributes:
        value: mean of the scenes that have a value; None when none has.
        present: how many scenes have a value.
        total: how many scenes there are.
    """

    value: float | None
    present: int
    total: int

    @property
    def complete(self) -> bool:
        """True if every scene has a value; only then is the mean one of the data set."""
        return self.total > 0 and self.present == self.total


def mean_of_present(values: Sequence[float | None]) -> Mean:
    """Mean over the values that are there, with the count of those that are not."""
    present = [value for value in values if value is not None]
    return Mean(fmean(present) if present else None, len(present), len(values))


def wilson_interval(successes: int, trials: int, confidence: float = 0.95) -> tuple[float, float]:
    """Wilson score interval of a proportion (Wilson 1927), within [0, 1].

    Raises `BadInput` unless 0 <= successes <= trials and trials >= 1.
    """
    _check_confidence(confidence)
    if trials < 1 or not 0 <= successes <= trials:
        raise BadInput(
            f"{successes} successes of {trials} trials", "0 <= successes <= trials, trials >= 1", "check the counts"
        )
    z = NormalDist().inv_cdf(0.5 + confidence / 2)
    p = successes / trials
    scale = 1 + z * z / trials
    centre = (p + z * z / (2 * trials)) / scale
    half = z / scale * math.sqrt(p * (1 - p) / trials + z * z / (4 * trials * trials))
    return max(0.0, centre - half), min(1.0, centre + half)


def bootstrap_interval(
    values: Sequence[float], confidence: float = 0.95, resamples: int = 2000, seed: int = 0
) -> tuple[float, float]:
    """Percentile bootstrap interval of the mean over scenes (Efron 1979), the same for the same seed.

    Raises `BadInput` for no values, or values that are not finite.
    """
    _check_confidence(confidence)
    if not values or not all(math.isfinite(value) for value in values):
        raise BadInput(f"values {list(values)}", "at least one finite value", "leave out scenes without a score")
    means = sorted(_resampled_means(values, resamples, seed))
    tail = (1 - confidence) / 2
    return _quantile(means, tail), _quantile(means, 1 - tail)


def _resampled_means(values: Sequence[float], resamples: int, seed: int) -> list[float]:
    """Means of samples drawn with replacement: those of ``random.Random(seed).choices``, many at a time.

    numpy is given Python's generator, so the samples are the same; columns are added up one after another, so the sums
    do not depend on the processor.
    """
    import numpy as np

    _, state, _ = random.Random(seed).getstate()
    draw = np.random.RandomState()
    draw.set_state(("MT19937", np.asarray(state[:-1], np.uint32), state[-1], 0, 0.0))
    known, n = np.asarray(values, np.float64), len(values)
    at_a_time, means = max(1, _DRAWN_AT_A_TIME // n), []
    for start in range(0, resamples, at_a_time):
        picks = (draw.random_sample((min(at_a_time, resamples - start), n)) * n).astype(np.intp)
        means += (np.add.reduce(np.ascontiguousarray(known[picks].T), axis=0) / n).tolist()
    return means


@dataclass(frozen=True)
class PairedTest:
    """Two methods (or two runs) on the same scenes.

    Attributes:
        n: number of scenes.
        mean_a, mean_b: means over them.
        difference: mean of b - a.
        low, high: bootstrap interval of that mean; None for a single scene, which has none.
        p: two-sided Wilcoxon signed-rank test (Wilcoxon 1945): chance of such differences if their median were zero;
            None for a single scene, 1 where no scene differs.
    """

    n: int
    mean_a: float
    mean_b: float
    difference: float
    low: float | None
    high: float | None
    p: float | None

    @property
    def beyond_interval(self) -> bool:
        """True if the interval leaves out zero; for a single scene, if the two numbers differ at all."""
        if self.low is None or self.high is None:
            return self.difference != 0
        return self.low > 0 or self.high < 0

    @property
    def significant(self) -> bool:
        """True if both say so: the interval leaves out zero and p < 0.05. Needs six scenes at least."""
        return self.p is not None and self.p < 0.05 and self.beyond_interval


def paired_test(a: Sequence[float], b: Sequence[float], confidence: float = 0.95) -> PairedTest:
    """Compare ``b`` with ``a``, scene by scene. Raises `BadInput` for other lengths, no scene, or non-finite values."""
    if len(a) != len(b) or not a or not all(map(math.isfinite, (*a, *b))):
        raise BadInput(
            f"{len(a)} values against {len(b)}", "finite values of the same scenes, one or more", "pair the scenes"
        )
    differences = [y - x for x, y in zip(a, b, strict=True)]
    low, high = bootstrap_interval(differences, confidence) if len(a) > 1 else (None, None)
    return PairedTest(len(a), fmean(a), fmean(b), fmean(differences), low, high, _wilcoxon(differences))


def _wilcoxon(differences: Sequence[float]) -> float | None:
    if len(differences) < 2:
        return None
    if not any(differences):
        return 1.0
    from scipy.stats import wilcoxon

    return float(wilcoxon(differences, zero_method="wilcox").pvalue)


def _quantile(ordered: Sequence[float], q: float) -> float:
    """Linear interpolation between order statistics (the definition of numpy's default)."""
    position = q * (len(ordered) - 1)
    low = math.floor(position)
    high = min(low + 1, len(ordered) - 1)
    return ordered[low] + (ordered[high] - ordered[low]) * (position - low)


def _check_confidence(confidence: float) -> None:
    if not 0 < confidence < 1:
        raise BadInput(f"confidence {confidence}", "a number between 0 and 1", "give 0.95 for a 95 % interval")
