"""The benchmark of MUSIQ and CLIP-IQA: both ways see the same frames and give the same scores."""

from __future__ import annotations

import json

import numpy as np
import pytest

from bench.metrics.learned_speed import LearnedSpeed, measure_learned_speed
from bench.speed.timing import Sample


def test_the_line_and_the_json_say_the_same() -> None:
    theirs = (Sample(4.0, 8.0), Sample(6.0, 8.0), Sample(4.0, 9.0))
    ours = (Sample(2.0, 4.0), Sample(2.0, 4.0), Sample(2.0, 3.0))
    speed = LearnedSpeed("musiq", "one frame per core", 12, 512, 2, theirs, ours, 1e-5)
    plain = json.loads(json.dumps(speed.to_json()))
    assert plain["ratio"] == {"wall": 2.0, "wall_low": 2.0, "wall_high": 3.0, "cpu": 2.0}
    assert (plain["pyiqa_s_per_frame"], plain["s_per_frame"]) == pytest.approx((14 / 12, 0.5))
    assert "2.00 times as fast (2.00 to 3.00; CPU time 2.00); scores within 1e-05" in speed.line()


@pytest.mark.slow
@pytest.mark.parametrize(("case", "ways"), [("musiq", 1), ("clipiqa", 2)])
def test_the_ways_score_alike(case: str, ways: int) -> None:
    found = measure_learned_speed(case, frames=1, side=64, threads=1, at_once=1)
    assert len(found) == ways
    for speed in found:
        assert (speed.frames, len(speed.theirs), len(speed.ours)) == (1, 1, 1)
        assert speed.largest_difference < 1e-4
        assert np.isfinite(speed.to_json()["ratio"]["wall"])
