"""Stage 3 as it is timed: all views watched, repairs counted, a checking part of the whole."""

from __future__ import annotations

import pytest

from bench.speed.stage3 import measure_stage3, stage3_line


@pytest.mark.slow
def test_a_small_measurement_adds_up() -> None:
    measured = measure_stage3(size=96, views=4, repairs=2, rounds=1)  # three would all stand where the input was taken
    assert measured["views"] == 4
    assert 1 <= measured["repairs"] <= 2
    assert measured["checking_seconds"] * measured["repairs"] + measured["render_seconds"] < measured["seconds"]
    assert measured["checking_share"] == measured["checking_seconds"] / measured["render_seconds"]


def test_the_line_says_what_the_target_is_about() -> None:
    measured = {"scene": "s", "size": 512, "views": 50, "repairs": 20, "anchors": 1, "seconds": 12.34}
    measured |= {"render_seconds": 4.0, "checking_seconds": 0.2, "checking_share": 0.05}
    assert stage3_line(measured) == (
        "stage 3, s, 50 views of 512x512: 20 repairs in 12.3 s; "
        "checking 200 ms a repair, 5.0% of rendering all views (4.00 s)"
    )
