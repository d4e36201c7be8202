"""The repair ledger as a JSON document."""

from __future__ import annotations

import json
from typing import Any

import pytest

from orca.errors import BadInput
from orca.repair.ledger import Ledger, RepairRecord
from orca.repair.rules import RepairRules

RECORD = RepairRecord(
    iteration=0,
    view=17,
    area=1234,
    fill=0.25,
    bbox=(10, 20, 110, 70),
    decision="local",
    rule="generative_min_area",
    reason="1234 px < 9000 px",
    donors=456,
    scheme="smooth:background",
    anchors_added=1000,
    coverage_before=0.1,
    coverage_after=0.95,
    milliseconds=12.5,
)
LEDGER = Ledger(RepairRules(), RepairRules().scaled(640, 480), (640, 480), (RECORD,), "no large disocclusion left")


def test_a_ledger_survives_json() -> None:
    document = json.loads(json.dumps(LEDGER.to_json()))
    assert document["schema_version"] == 1
    assert document["repairs"][0]["bbox"] == [10, 20, 110, 70]
    assert document["rules"]["generative_min_area"] == 9000
    assert document["scaled_rules"]["generative_min_area"] == 10547  # 9000 * 640 * 480 / 512^2 = 10546.9
    assert Ledger.from_json(document) == LEDGER
    assert len(LEDGER) == 1
    assert list(LEDGER) == [RECORD]


@pytest.mark.parametrize(
    "change",
    [
        {"schema_version": 99},
        {"schema_version": None},
        {"repairs": [{"iteration": 0}]},
        {"repairs": None},
        {"rules": {"no_such_rule": 1}},
        {"size": [1]},
    ],
)
def test_a_broken_ledger_is_refused(change: dict[str, Any]) -> None:
    with pytest.raises(BadInput):
        Ledger.from_json({**LEDGER.to_json(), **change})
