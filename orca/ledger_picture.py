"""The repair ledger as one picture: what was missing, which rule decided each component, and what came of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from orca.anchors import Stage
from orca.camera import Camera
from orca.conventions import UInt8Array, to_uint8
from orca.errors import BadInput
from orca.images import save_image
from orca.repair.components import BoolArray
from orca.repair.ledger import Ledger, RepairRecord
from orca.scene import Scene

__all__ = ["RULE_COLOURS", "ledger_picture", "write_ledger_picture"]

RULE_COLOURS: dict[str, tuple[int, int, int]] = {
    "generative_min_area": (66, 135, 245),
    "generative_min_fill": (245, 158, 66),
    "generative_min_side": (46, 184, 92),
    "generative_budget": (186, 104, 200),
    "no_inpainter": (229, 57, 53),
    "generative_failed": (140, 30, 60),
    "all_hold": (255, 214, 10),
}
"""Colour of a component by the rule that decided it (`RepairRecord.rule`); local but for "all_hold"."""

_OTHER = (158, 158, 158)
_MISSING = (255, 0, 255)
_GAP = 6
_LINE = 22


def ledger_picture(
    scene: Scene, cameras: Sequence[Camera], ledger: Ledger, views: int = 3, width: int = 320
) -> UInt8Array:
    """One row for each of the views with the largest repaired area: missing pixels, decisions, the view afterwards.

    Args:
        scene: the repaired scene; without its repaired anchors it is what stage 3 began with.
        cameras: the trajectory that the ledger's views are indices of.
        ledger: all repairs of the scene.
        views: rows at most.
        width: of one panel in pixels.

    Returns:
        [h, w, 3] uint8 on white, with a legend of the rules and how often each decided.

    Raises:
        BadInput: a ledger that names views which the trajectory does not have.
    """
    if any(record.view >= len(cameras) for record in ledger):
        last = max(record.view for record in ledger)
        raise BadInput(
            f"a ledger of view {last} with {len(cameras)} cameras", "the path of the repair", "pass that one"
        )
    before = replace(scene, anchors=scene.anchors.subset(scene.anchors.stage != int(Stage.REPAIRED)))
    renderers = before.renderer(), scene.renderer()
    rows = []
    for view in _most_repaired(ledger, views):
        records = [record for record in ledger if record.view == view]
        first, after = (renderer.render(cameras[view]) for renderer in renderers)
        missing = np.zeros(first.alpha.shape, bool)
        for record in records:
            _box(missing, record)[...] |= record.component()
        panels = [
            _mark(to_uint8(first.rgb), missing, _MISSING),
            _decisions(to_uint8(first.rgb), records),
            to_uint8(after.rgb),
        ]
        titles = (f"view {view}: {int(missing.sum())} px missing", f"{len(records)} repairs", "after")
        rows.append(_row([_panel(p, width, t) for p, t in zip(panels, titles, strict=True)]))
    wide = 3 * width + 2 * _GAP
    return np.concatenate([*rows, _legend(ledger, wide)], axis=0)


def write_ledger_picture(scene: Scene, cameras: Sequence[Camera], document: dict[str, Any], path: Path) -> bool:
    """Draw the ledger of a reconstruction (`orca.pipeline.Reconstruction.ledger`) into a PNG.

    Returns whether there was anything to draw: no file is written for a scene without repairs.
    """
    if not document["repairs"]:
        return False
    save_image(path, ledger_picture(scene, cameras, Ledger.from_json(document)))
    return True


def _most_repaired(ledger: Ledger, count: int) -> list[int]:
    area: Counter[int] = Counter()
    for record in ledger:
        area[record.view] += record.area
    return sorted(view for view, _ in area.most_common(count))


def _box(image: BoolArray | UInt8Array, record: RepairRecord) -> BoolArray | UInt8Array:
    x0, y0, x1, y1 = record.bbox
    return image[y0:y1, x0:x1]


def _mark(image: UInt8Array, mask: BoolArray, colour: tuple[int, int, int]) -> UInt8Array:
    marked = image.copy()
    marked[mask] = colour
    return marked


def _decisions(image: UInt8Array, records: Sequence[RepairRecord]) -> UInt8Array:
    """The dimmed view with each component in its rule's colour."""
    dim = (image // 3 + 20).astype(np.uint8)
    for record in records:
        _box(dim, record)[record.component()] = RULE_COLOURS.get(record.rule, _OTHER)
    return dim


def _panel(image: UInt8Array, width: int, title: str) -> UInt8Array:
    """A view at the width of a panel, under its title."""
    height = round(image.shape[0] * width / image.shape[1])
    smaller = width < image.shape[1]
    how = cv2.INTER_AREA if smaller else cv2.INTER_NEAREST
    scaled = np.asarray(cv2.resize(image, (width, height), interpolation=how), np.uint8)
    return np.concatenate([_text(title, width), scaled], axis=0)


def _row(panels: Sequence[UInt8Array]) -> UInt8Array:
    gap = np.full((panels[0].shape[0], _GAP, 3), 255, np.uint8)
    row = np.concatenate([panels[0], gap, panels[1], gap, panels[2]], axis=1)
    return np.concatenate([row, np.full((_GAP, row.shape[1], 3), 255, np.uint8)], axis=0)


def _text(words: str, width: int, indent: int = 4) -> UInt8Array:
    line = np.full((_LINE, width, 3), 255, np.uint8)
    return np.asarray(
        cv2.putText(line, words, (indent, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (0, 0, 0), 1, cv2.LINE_AA), np.uint8
    )


def _legend(ledger: Ledger, width: int) -> UInt8Array:
    """A line for each rule that decided something, and why the repair ended."""
    lines = []
    for (rule, decision), count in sorted(Counter((r.rule, r.decision) for r in ledger).items()):
        line = _text(f"{count} x {rule}: {decision}", width, indent=28)
        line[4:18, 6:22] = RULE_COLOURS.get(rule, _OTHER)
        lines.append(line)
    end = f"{len(ledger)} repairs along {ledger.views} views; {ledger.stopped}"
    return np.concatenate([*lines, _text(end, width)], axis=0)
