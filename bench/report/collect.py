"""What the page shows, as plain data: numbers and reasons from a run's files, pictures from its frames."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench.chart import CHART_COSTS, cost_value
from bench.datasets import Dataset, SceneCase, open_dataset
from bench.frames import load_frames
from bench.measured import COSTS, Column, Measured
from bench.record import CellRecord, jsonable
from bench.report.ledger import draw_ledger, read_ledger
from bench.report.media import FPS, Media, depth_picture, encode_video, webp
from bench.store import RunStore
from orca.conventions import UInt8Array
from orca.errors import OrcaError

__all__ = ["MORE_COSTS", "Sources", "as_script", "collect_scenes", "problems", "shown_columns"]

_log = logging.getLogger(__name__)
# What the page shows beside the costs of a printed table; both in 1e6 bytes.
MORE_COSTS = (Column("bytes", "Model MB", 1, False), Column("memory", "MB added at the peak", 0, False))
_CHARTED = tuple(column.key for column in CHART_COSTS)


@dataclass(frozen=True, eq=False)
class Sources:
    """Where pictures come from.

    Attributes:
        store: the run.
        run: its ``run.json``.
        data_root: where the data lie now; None for where they lay then.
        rung: longest side of the videos in pixels, and their H.264 rate factor.
        missing: what the page had to leave out, in words; grows while the page is made.
    """

    store: RunStore
    run: dict[str, Any]
    data_root: Path | None = None
    rung: tuple[int, int] = (384, 26)
    missing: list[str] = field(default_factory=list)

    def dataset(self) -> Dataset | None:
        """The data set of the run, or None, and a line in ``missing``, when it is not here."""
        identity = self.run["identity"]
        folders = self.run.get("folders", {})
        root = self.data_root or (Path(folders["data_root"]) if folders.get("data_root") else None)
        images = Path(identity["images"]) if identity.get("images") else None
        try:
            dataset = open_dataset(
                identity["dataset"], data_root=root, images=images, trajectory=identity["trajectory"]
            )
            dataset.scenes()
        except OrcaError as error:
            self.missing.append(f"input pictures and depth: {error.given}")
            return None
        return dataset


def shown_columns(run: Measured) -> tuple[Column, ...]:
    """Metrics and costs that have at least one number; the others are listed with their reasons instead."""
    columns = (*run.columns, *COSTS, *MORE_COSTS)
    return tuple(c for c in columns if any(_number(run, m, s, c) is not None for m, s in _cells(run)))


def _cells(run: Measured) -> Iterable[tuple[str, str]]:
    return ((method, scene) for method in run.methods for scene in run.scenes)


def _number(run: Measured, method: str, scene: str, column: Column) -> float | None:
    """A score, or a cost as the chart has it: what was only rendered here has no seconds."""
    if column.key not in _CHARTED:
        return run.value(method, scene, column.key).number
    record = run.records.get((method, scene))
    return None if record is None else cost_value(record, column.key).number


def collect_scenes(run: Measured, sources: Sources, media: Media) -> list[dict[str, Any]]:
    """One entry a scene: pictures, videos, numbers, failures, repairs. Adds its files to ``media``."""
    dataset = sources.dataset()
    return [_scene(run, scene, sources, _load(dataset, scene, sources), media) for scene in run.scenes]


def _load(dataset: Dataset | None, scene: str, sources: Sources) -> SceneCase | None:
    if dataset is None:
        return None
    try:
        return dataset.load(scene)
    except OrcaError as error:
        sources.missing.append(f"input and depth of {scene}: {error.given}")
        return None


def _scene(run: Measured, scene: str, sources: Sources, case: SceneCase | None, media: Media) -> dict[str, Any]:
    entry: dict[str, Any] = {"name": scene, "fps": FPS, "videos": {}, "values": {}, "failures": {}, "ledgers": {}}
    entry["notes"] = {}
    if case is not None:
        picture, near, far = depth_picture(case.depth)
        entry["input"] = media.add("image/webp", webp(case.image))
        entry["depth"] = media.add("image/webp", webp(picture))
        entry["depth_text"] = f"{case.depth_source}; bright {near:.2f}, dark {far:.2f} scene radii"
        entry["size"] = [case.camera.width, case.camera.height]
    for method in run.methods:
        record = run.records.get((method, scene))
        if record is None:
            continue
        if record.failure is not None:
            entry["failures"][method] = record.failure.summary
            continue
        entry["values"][method] = {c.key: _number(run, method, scene, c) for c in shown_columns(run)}
        entry["notes"][method] = list(record.notes)
        entry["indices"] = [frame.index for frame in record.frames]
        _add_video(entry, method, record, sources, media)
        _add_ledger(entry, method, record, sources, case, media)
    plain: dict[str, Any] = jsonable(entry)
    return plain


def _add_video(entry: dict[str, Any], method: str, record: CellRecord, sources: Sources, media: Media) -> None:
    output = load_frames(sources.store.frames_path(record.method, record.scene), record)
    if output is None:
        sources.missing.append(f"frames of {method} on {record.scene}: gone, or not those of the record")
        return
    first: UInt8Array = output.frames[0]
    entry["frame_size"] = [first.shape[1], first.shape[0]]
    entry["videos"][method] = media.add("video/mp4", encode_video(output.frames, *sources.rung))


def _add_ledger(
    entry: dict[str, Any], method: str, record: CellRecord, sources: Sources, case: SceneCase | None, media: Media
) -> None:
    root = sources.store.root
    ledger = read_ledger(root, record)
    if not ledger:
        return
    entry["ledgers"][method] = ledger
    try:
        picture = None if case is None else draw_ledger(root, record, case)
    except OrcaError as error:
        sources.missing.append(f"ledger picture of {method} on {record.scene}: {error.given}")
        return
    if picture is not None:
        ledger["picture"] = media.add("image/webp", webp(picture, max(picture.shape)))


def problems(run: Measured) -> list[dict[str, str]]:
    """Failures of methods and metrics, and metrics without a value, each reason once with what it touches."""
    found: dict[tuple[str, str, str], list[str]] = {}
    for (method, scene), record in run.records.items():
        if record.failure is not None:
            found.setdefault((method, record.failure.kind, record.failure.summary), []).append(scene)
        for score in record.scores.values():
            if score.value is None:
                title = str(score.spec.get("title", ""))
                found.setdefault((title, score.status, score.reason or ""), []).append(f"{method} · {scene}")
    order = {"failed": 1, "unavailable": 2, "not_applicable": 3}
    return [
        {"what": what, "kind": kind.replace("_", " "), "reason": reason, "where": _listed(where, run)}
        for (what, kind, reason), where in sorted(found.items(), key=lambda item: (order.get(item[0][1], 0), item[0]))
    ]


def _listed(where: list[str], run: Measured) -> str:
    if len(where) >= len(run.methods) * len(run.scenes):
        return "every method and scene"
    return ", ".join(where[:6]) + (f" and {len(where) - 6} more" if len(where) > 6 else "")


def as_script(document: Any) -> str:
    """JSON that may stand inside a script element: no `<`, `>` or `&` in it, whatever the names."""
    text = json.dumps(jsonable(document), ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
