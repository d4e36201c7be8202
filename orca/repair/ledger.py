"""The repair ledger: one row per repair, so that the method's reasoning can be read and plotted."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from typing import Any

from orca.errors import BadInput
from orca.repair.rules import RepairRules

__all__ = ["LEDGER_SCHEMA_VERSION", "Ledger", "RepairRecord"]

LEDGER_SCHEMA_VERSION = 1


@dataclass(frozen=True)
class RepairRecord:
    """One repair.

    Attributes:
        iteration: number of the repair in its scene, from 0.
        view: index of the view in the trajectory.
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

    @staticmethod
    def from_json(row: dict[str, Any]) -> RepairRecord:
        """Read a row that `Ledger.to_json` wrote."""
        try:
            x0, y0, x1, y1 = row["bbox"]
            return RepairRecord(**{**row, "bbox": (x0, y0, x1, y1)})
        except (KeyError, TypeError, ValueError) as error:
            raise BadInput(f"a ledger row that does not read: {error}", "rows of schema 1", "write it again") from error


@dataclass(frozen=True)
class Ledger:
    """All repairs of a scene.

    Attributes:
        rules: thresholds as configured, for renders of 512 x 512.
        scaled_rules: thresholds as applied, for the size of this scene's renders; every row refers to these.
        size: (width, height) of the renders.
        records: the repairs in their order.
        stopped: why the loop ended, in words.
    """

    rules: RepairRules
    scaled_rules: RepairRules
    size: tuple[int, int]
    records: tuple[RepairRecord, ...] = field(default=())
    stopped: str = ""

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
            "repairs": [{**asdict(record), "bbox": list(record.bbox)} for record in self.records],
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
            )
        except (KeyError, TypeError, ValueError) as error:
            raise BadInput(f"a repair ledger that does not read: {error}", "what to_json wrote", "run again") from error
