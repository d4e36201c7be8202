"""The depth of what was hidden, by hand; and what holes become under the nearest fill."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from bench.adapters import MethodOutput, RunOptions
from bench.adapters.warp import WARP, WARP_NEAREST
from bench.checks import BadOutput, check_output
from bench.datasets.case import SceneCase, TrueView
from bench.datasets.synthetic import Synthetic
from bench.metrics import METRICS
from bench.metrics.hidden import HiddenDepth
from bench.metrics.metric import MetricInput, Score


@pytest.fixture(scope="module")
def case() -> SceneCase:
    return Synthetic(size=32).load("predictable-00")


def by_hand(case: SceneCase) -> SceneCase:
    """One true view of 32 x 32: row 0 hidden by another object, row 1 by itself, true depth 2, occluder 1."""
    hidden = np.zeros((32, 32), bool)
    hidden[:2] = True
    occluder = np.full((32, 32), np.nan, np.float32)
    occluder[0] = 1.0
    view = TrueView(case.camera, case.true_views[0].image, hidden, np.full((32, 32), 2.0, np.float32), occluder)
    return dataclasses.replace(case, true_views=(view,))


def score(case: SceneCase, depth: np.ndarray | None, alpha: np.ndarray | None) -> Score:
    output = MethodOutput(
        np.zeros((13, 32, 32, 3), np.uint8),
        true_view_depth=None if depth is None else (depth.astype(np.float32),),
        true_view_coverage=None if alpha is None else (alpha.astype(np.float32),),
    )
    return HiddenDepth().compute(MetricInput(case, output))["hidden_depth"]


def test_share_by_hand(case: SceneCase) -> None:
    depth, alpha = np.full((32, 32), 9.0), np.ones((32, 32))
    depth[0, :8], depth[0, 8:24], depth[0, 24:] = 1.4, 1.6, 3.0
    alpha[0, 20:24] = 0.49
    found = score(by_hand(case), depth, alpha)
    assert found.detail == {"judged": 32, "filled": 28, "right": 20}
    assert found.value == pytest.approx(20 / 28)


def test_halfway_is_not_nearer(case: SceneCase) -> None:
    assert score(by_hand(case), np.full((32, 32), 1.5), np.ones((32, 32))).value == 0.0


def test_reasons_for_no_value(case: SceneCase) -> None:
    ones = np.ones((32, 32))
    assert "no true depth" in str(score(dataclasses.replace(case, true_views=()), ones, ones).reason)
    assert "no depth at the true views" in str(score(by_hand(case), None, ones).reason)
    assert "no hidden pixel" in str(score(by_hand(case), ones, 0 * ones).reason)
    assert METRICS.get("hidden_depth") is HiddenDepth


def test_depth_of_another_shape_is_refused(case: SceneCase) -> None:
    warped = WARP.run(case, RunOptions())
    check_output(case, warped)
    wrong = tuple(np.zeros((3, 3), np.float32) for _ in case.true_views)
    with pytest.raises(BadOutput, match="true_view_depth"):
        check_output(case, dataclasses.replace(warped, true_view_depth=wrong))


def test_nearest_fill_keeps_what_was_hit_and_takes_the_rest_from_it(case: SceneCase) -> None:
    holes, filled = WARP.run(case, RunOptions()), WARP_NEAREST.run(case, RunOptions())
    assert holes.coverage is not None
    hit = holes.coverage > 0
    assert not hit.all()
    np.testing.assert_array_equal(filled.frames[hit], holes.frames[hit])
    for frame, before, kept in zip(filled.frames, holes.frames, hit, strict=True):
        assert {tuple(c) for c in frame[~kept]} <= {tuple(c) for c in before[kept]}


def test_depth_of_true_views_survives_storage(tmp_path: Path, case: SceneCase) -> None:
    from bench.frames import frame_hashes, load_frames, save_frames
    from bench.record import CellRecord

    frames = np.zeros((1, 4, 5, 3), np.uint8)
    depth = (np.random.default_rng(0).uniform(0, 3, (4, 5)).astype(np.float32),)
    save_frames(tmp_path / "a.npz", MethodOutput(frames, true_views=(frames[0],), true_view_depth=depth))
    record = CellRecord("synthetic", "s", "m", "1", None, frames=frame_hashes(frames, [0]))
    loaded = load_frames(tmp_path / "a.npz", record)
    assert loaded is not None
    assert loaded.true_view_depth is not None
    np.testing.assert_array_equal(loaded.true_view_depth[0], depth[0])
