"""The ledger as a picture: every repaired pixel in the colour of the rule that decided it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from orca.errors import BadInput
from orca.images import load_image
from orca.ledger_picture import RULE_COLOURS, ledger_picture, write_ledger_picture
from orca.pipeline import Reconstruction, reconstruct
from orca.repair.ledger import Ledger
from tests.orca.repair_scenes import SIZE, estimate, input_camera, picture, sideways, small_config

VIEWS = sideways(0.1)
TITLE, GAP = 22, 6


@pytest.fixture(scope="module")
def repaired() -> Reconstruction:
    image, depth = picture()
    return reconstruct(image, input_camera(), estimate(depth), VIEWS, small_config())


def test_panels_show_mask_decision_and_result(repaired: Reconstruction) -> None:
    ledger = Ledger.from_json(repaired.ledger)
    drawn = ledger_picture(repaired.scene, VIEWS, ledger, views=1, width=SIZE)
    view = max({r.view for r in ledger}, key=lambda v: sum(r.area for r in ledger if r.view == v))
    mask = np.zeros((SIZE, SIZE), bool)
    for record in (r for r in ledger if r.view == view):
        x0, y0, x1, y1 = record.bbox
        mask[y0:y1, x0:x1] |= record.component()
    panels = [drawn[TITLE : TITLE + SIZE, i * (SIZE + GAP) : i * (SIZE + GAP) + SIZE] for i in range(3)]
    np.testing.assert_array_equal((panels[0] == (255, 0, 255)).all(2), mask)
    np.testing.assert_array_equal((panels[1] == RULE_COLOURS["generative_min_area"]).all(2), mask)
    after = np.clip(repaired.scene.renderer().render(VIEWS[view]).rgb, 0, 1)
    assert np.abs(panels[2] / 255 - after).max() <= 1 / 255
    legend = (drawn == RULE_COLOURS["generative_min_area"]).all(2)[TITLE + SIZE + GAP :]
    assert legend.sum() == 14 * 16


def test_a_file_is_written_where_there_are_repairs(repaired: Reconstruction, tmp_path: Path) -> None:
    path = tmp_path / "ledger.png"
    nothing = {"schema_version": 1, "repairs": [], "stopped": "repair is off"}
    assert not write_ledger_picture(repaired.scene, VIEWS, nothing, path)
    assert not path.exists()
    assert write_ledger_picture(repaired.scene, VIEWS, repaired.ledger, path)
    assert load_image(path).shape[1] == 3 * 320 + 2 * GAP


def test_another_trajectory_is_refused(repaired: Reconstruction) -> None:
    ledger = Ledger.from_json(repaired.ledger)
    late = replace(ledger, records=(replace(ledger.records[0], view=len(VIEWS)),))
    with pytest.raises(BadInput, match="view 3 with 3 cameras"):
        ledger_picture(repaired.scene, VIEWS, late)
