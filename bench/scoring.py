"""Metrics by family: each class is made once a run and computes all of its ids at once."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.adapters.adapter import MethodOutput
from bench.datasets.case import SceneCase
from bench.metrics.metric import Configurable, Metric, MetricInput, MetricOptions, MetricSpec
from bench.record import ScoreRecord
from bench.scorecache import ScoreCache, content_hashes
from orca.errors import CannotWrite
from orca.registry import Registry

__all__ = ["Scorer"]


@dataclass(frozen=True)
class _Family:
    name: str
    metric: Metric
    specs: dict[str, MetricSpec]  # every id of this class, asked for or not
    broken: Exception | None  # what `specs` raised


class Scorer:
    """The metrics of a run.

    Args:
        ids: metric ids asked for.
        registry: id -> metric class; several ids may name one class.
        weights_dir: folder with downloaded weights, or None.
        device: "cpu" or "cuda".
        cache: where scores are looked for before they are computed, and kept after; None for nowhere.
        options: what the user chose about metrics that have options.

    Raises:
        Unknown: an id that the registry does not know.
    """

    def __init__(
        self,
        ids: Sequence[str],
        registry: Registry[type[Metric]],
        weights_dir: Path | None = None,
        device: str = "cpu",
        cache: ScoreCache | None = None,
        options: MetricOptions | None = None,
    ) -> None:
        self.ids = tuple(registry.check(metric_id) for metric_id in ids)
        self._weights_dir, self._device, self._cache = weights_dir, device, cache
        self._options = options or MetricOptions()
        self._hashed: tuple[MethodOutput, dict[str, Any]] | None = None  # of the output that was scored last
        self._families: list[_Family] = []
        by_class: dict[type[Metric], list[str]] = {}
        for metric_id in self.ids:
            by_class.setdefault(registry.get(metric_id), []).append(metric_id)
        for cls, wanted in by_class.items():
            self._families.append(self._family(cls, wanted))

    @property
    def specs(self) -> dict[str, MetricSpec]:
        """Spec of every id asked for, in that order."""
        found = {metric_id: spec for family in self._families for metric_id, spec in family.specs.items()}
        return {metric_id: found[metric_id] for metric_id in self.ids}

    def families(self, missing: Sequence[str]) -> list[str]:
        """Names of the metric classes that have to run for these ids."""
        return [family.name for family in self._families if set(family.specs) & set(missing)]

    def compute(self, name: str, case: SceneCase, output: MethodOutput) -> tuple[dict[str, ScoreRecord], float]:
        """Run one family; return its scores by id, and the seconds that they took.

        A family computes all of its ids in one go, so ids nobody asked for come along and are kept. A metric that is
        `Unavailable`, or raises, gives scores that say so; nothing is raised. Scores of the same content and specs
        are taken from the cache.
        """
        family = next(family for family in self._families if family.name == name)
        started = time.perf_counter()
        given = MetricInput(case, output, self._weights_dir, self._device)
        if self._cache is None or family.broken is not None:
            return _family_scores(family, given), time.perf_counter() - started
        key = self._cache.key(family.metric, family.specs, self._content(case, output), self._device)
        scores = self._cache.get(key, family.specs)
        if scores is None:
            scores = _family_scores(family, given)
            self._cache.put(key, scores)
        return scores, time.perf_counter() - started

    def _content(self, case: SceneCase, output: MethodOutput) -> dict[str, Any]:
        if self._hashed is None or self._hashed[0] is not output:
            self._hashed = (output, content_hashes(case, output))
        return self._hashed[1]

    def failed_family(self, name: str, error: Exception) -> dict[str, ScoreRecord]:
        """Scores of the ids of one family, asked for or not, as `compute` gives them: they say why there is none."""
        family = next(family for family in self._families if family.name == name)
        return {metric_id: ScoreRecord.without_value(spec, error) for metric_id, spec in family.specs.items()}

    def failed_scores(self, missing: Sequence[str], error: Exception) -> dict[str, ScoreRecord]:
        """Scores of ids that could not be computed because their frames or their scene could not be had."""
        return {metric_id: ScoreRecord.without_value(self.specs[metric_id], error) for metric_id in missing}

    def _family(self, cls: type[Metric], wanted: list[str]) -> _Family:
        metric = cls()
        if isinstance(metric, Configurable):
            metric.configure(self._options)
        broken: Exception | None = None
        try:
            specs = {spec.id: spec for spec in metric.specs(self._weights_dir)}
        except Exception as error:  # noqa: BLE001 - kept, and raised again where the scores would be
            broken, specs = error, {}
        for metric_id in wanted:  # a column stands even where its spec needs weights that are not here
            specs.setdefault(metric_id, MetricSpec(metric_id, metric_id, True, (None, None), "unknown", "unknown"))
        return _Family(cls.__name__, metric, specs, broken)


def _family_scores(family: _Family, given: MetricInput) -> dict[str, ScoreRecord]:
    try:
        if family.broken is not None:
            raise family.broken
        scores = family.metric.compute(given)
    except CannotWrite:
        raise
    except Exception as error:  # noqa: BLE001 - one broken metric must not end the run; kept, typed, in the score
        return {key: ScoreRecord.without_value(spec, error) for key, spec in family.specs.items()}
    absent = KeyError(f"{family.name} returned no score of that id")
    return {
        key: ScoreRecord.of(scores[key], spec) if key in scores else ScoreRecord.without_value(spec, absent)
        for key, spec in family.specs.items()
    }
