"""The repair ledger: one row per repair, so that the method's reasoning can be read and plotted."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from orca.errors import BadInput
from orca.repair.components import BoolArray
from orca.repair.rules import RepairRules

__all__ = ["LEDGER_SCHEMA_VERSION", "Ledger", "RepairRecord", "run_lengths"]

LEDGER_SCHEMA_VERSION = 1


@dataclass(frozen=True)
class RepairRecord:
    """One repair.

    Attributes:
        iteration: number of the repair in its scene, from 0.
        view: index of the view in the trajectory: the watched one with the largest disocclusion.
        area: missing pixels of the component.
        fill: share of its bounding box that is missing.
        bbox: (x0, y0, x1, y1) in pixels, the far ends excluded.
        decision: what was done: "local" or "generative".
        rule: the rule that decided it (`Decision.rule`).
        reason: that rule with its numbers; where a generative repair fell back to a local one, why.
        donors: donor pixels used.
        scheme: how the target was filled (`FillTarget.scheme`).
        anchors_added: anchors inserted.
        coverage_before: mean accumulated alpha inside the component before the repair.
        coverage_after: ... and after it.
        milliseconds: wall time of the repair.
        alignment: of a generative repair with estimated depth: "a", "b", "inlier_share", "samples", and the "space"
            of the fit ("depth" or "inverse_depth"); None otherwise.
        view_area: missing pixels of that view, in components that are large enough.
        trajectory_area: ... of all watched views together.
        mask: the component inside its bounding box, row by row, as run lengths that begin with pixels outside it.
        foretold: share of the texture that was continued where the fill continues structure; None otherwise.
        checking_milliseconds: the part of the wall time in which the watched views were looked at again.
    """

    iteration: int
    view: int
    area: int
    fill: float
    bbox: tuple[int, int, int, int]
    decision: str
    rule: str
    reason: str
    donors: int
    scheme: str
    anchors_added: int
    coverage_before: float
    coverage_after: float
    milliseconds: float
    alignment: dict[str, Any] | None = None
    view_area: int = 0
    trajectory_area: int = 0
    mask: tuple[int, ...] = ()
    checking_milliseconds: float = 0.0
    foretold: float | None = None

    def component(self) -> BoolArray:
        """The repaired region inside its bounding box, bool; raises `BadInput` where the runs do not fill the box."""
        x0, y0, x1, y1 = self.bbox
        runs = np.array(self.mask, np.int64)
        if (runs < 0).any() or runs.sum() != (y1 - y0) * (x1 - x0):
            raise BadInput("a ledger mask that does not fill its box", "run lengths of the whole box", "run it again")
        return np.repeat(np.arange(len(runs)) % 2 == 1, runs).reshape(y1 - y0, x1 - x0)

    @staticmethod
    def from_json(row: dict[str, Any]) -> RepairRecord:
        """Read a row that `Ledger.to_json` wrote."""
        try:
            x0, y0, x1, y1 = row["bbox"]
            return RepairRecord(**{**row, "bbox": (x0, y0, x1, y1), "mask": tuple(row.get("mask", ()))})
        except (KeyError, TypeError, ValueError) as error:
            raise BadInput(f"a ledger row that does not read: {error}", "rows of schema 1", "write it again") from error


def run_lengths(mask: BoolArray) -> tuple[int, ...]:
    """A mask row by row as run lengths, the first one (possibly 0) of False."""
    flat = mask.ravel()
    ends = np.flatnonzero(np.diff(flat)) + 1
    runs = np.diff(np.concatenate([[0], ends, [len(flat)]]))
    return (0, *map(int, runs)) if len(flat) and flat[0] else tuple(map(int, runs))


@dataclass(frozen=True)
class Ledger:
    """All repairs of a scene.

    Attributes:
        rules: thresholds as configured, for renders of 512 x 512.
        scaled_rules: thresholds as applied, for the size of this scene's renders; every row refers to these.
        size: (width, height) of the renders.
        records: the repairs in their order.
        stopped: why the loop ended, in words.
        views: how many views were watched.
        render_milliseconds: what rendering them all once took.
    """

    rules: RepairRules
    scaled_rules: RepairRules
    size: tuple[int, int]
    records: tuple[RepairRecord, ...] = field(default=())
    stopped: str = ""
    views: int = 0
    render_milliseconds: float = 0.0

    def __iter__(self) -> Iterator[RepairRecord]:
        return iter(self.records)

    def __len__(self) -> int:
        return len(self.records)

    def to_json(self) -> dict[str, Any]:
        """A JSON document with ``schema_version``, both sets of thresholds and one object per repair."""
        return {
            "schema_version": LEDGER_SCHEMA_VERSION,
            "size": list(self.size),
            "rules": self.rules.to_json(),
            "scaled_rules": self.scaled_rules.to_json(),
            "stopped": self.stopped,
            "views": self.views,
            "render_milliseconds": self.render_milliseconds,
            "repairs": [
                {**asdict(record), "bbox": list(record.bbox), "mask": list(record.mask)} for record in self.records
            ],
        }

    @staticmethod
    def from_json(document: dict[str, Any]) -> Ledger:
        """Read what `to_json` wrote; raise `BadInput` for another schema or a broken document."""
        version = document.get("schema_version")
        if version != LEDGER_SCHEMA_VERSION:
            raise BadInput(
                f"a repair ledger of schema {version!r}", f"schema {LEDGER_SCHEMA_VERSION}", "run the repair again"
            )
        try:
            width, height = document["size"]
            return Ledger(
                rules=RepairRules(**document["rules"]),
                scaled_rules=RepairRules(**document["scaled_rules"]),
                size=(width, height),
                records=tuple(RepairRecord.from_json(row) for row in document["repairs"]),
                stopped=document["stopped"],
                views=document.get("views", 0),
                render_milliseconds=document.get("render_milliseconds", 0.0),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise BadInput(f"a repair ledger that does not read: {error}", "what to_json wrote", "run again") from error
