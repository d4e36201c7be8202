"""Scores by what they were computed from, so that equal pixels are scored once: over methods, versions and runs."""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from bench.adapters.adapter import MethodOutput
from bench.datasets.case import SceneCase
from bench.digest import broken_seals, digest, sealed
from bench.frames import frame_hashes
from bench.metrics.metric import Metric, MetricSpec
from bench.provenance import case_hashes, output_hashes
from bench.record import NOT_APPLICABLE, OK, ScoreRecord, jsonable
from bench.store import write_json

__all__ = ["ScoreCache", "content_hashes"]

_log = logging.getLogger(__name__)


def content_hashes(case: SceneCase, output: MethodOutput) -> dict[str, Any]:
    """Hashes of everything a metric may look at: part -> hash or plain data.

    Parts: "frames"; "coverage", "input_view", "true_views", "true_view_coverage" of the method; "image", "depth",
    "camera", "trajectory", "reference_views" of the scene; "about", the plain facts of both.
    """
    scene = {f"reference_{key}" if key == "true_views" else key: value for key, value in case_hashes(case).items()}
    frames = [frame.pixel_sha256 for frame in frame_hashes(output.frames, case.eval_indices)]
    about = {"dataset": case.dataset, "scene": case.name, "model": jsonable(output.model), "notes": list(output.notes)}
    return {**scene, **output_hashes(output), "frames": frames, "shape": list(output.frames.shape), "about": about}


class ScoreCache:
    """A folder of scores, one file for each (content, specs).

    A metric may name the parts of `content_hashes` that it looks at in a class attribute ``needs`` (("frames",) for a
    no-reference score); without one all of them make the key, which is always right and finds less.

    Args:
        folder: made when the first score is kept.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = Path(folder)

    def key(self, metric: Metric, specs: Mapping[str, MetricSpec], content: Mapping[str, Any], device: str) -> str:
        """The key of one metric family's scores of one output."""
        needs: Sequence[str] | None = getattr(metric, "needs", None)
        parts = {part: content.get(part) for part in (needs if needs is not None else sorted(content))}
        makers = [[s.id, s.variant, s.version, s.weights_sha256] for s in specs.values()]
        return digest({"parts": parts, "specs": makers, "device": device})

    def get(self, key: str, specs: Mapping[str, MetricSpec]) -> dict[str, ScoreRecord] | None:
        """The scores kept under a key, with today's specs; None when there are none, or the file is not as written."""
        path = self._path(key)
        if not path.is_file():
            return None
        try:
            document = json.loads(path.read_text())
            if broken_seals(document) or document["key"] != key:
                raise ValueError("not as it was written")
            return {
                metric_id: ScoreRecord(**{**document["scores"][metric_id], "spec": jsonable(asdict(spec))})
                for metric_id, spec in specs.items()
            }
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            _log.warning("%s is left aside (%s): its scores are computed again", path, error)
            return None

    def put(self, key: str, scores: Mapping[str, ScoreRecord]) -> None:
        """Keep scores; what failed or was unavailable is not kept."""
        if all(score.status in (OK, NOT_APPLICABLE) for score in scores.values()):
            kept = {metric_id: asdict(score) for metric_id, score in scores.items()}
            write_json(self._path(key), sealed({"schema_version": 1, "key": key, "scores": jsonable(kept)}))

    def _path(self, key: str) -> Path:
        return self._folder / key[:2] / f"{key}.json"
