"""The depth of frames at rest: float16 and back, none where there is none, scores that do not depend on when."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench.adapters.adapter import MethodOutput, RunOptions
from bench.adapters.warp import WARP, WARP_TELEA
from bench.checks import BadOutput, check_output
from bench.frames import frame_hashes, load_frames, save_frames, stored_precision
from bench.metrics.flicker import Flicker
from bench.metrics.metric import MetricInput
from bench.record import CellRecord
from tests.bench.small_cases import make_case, noise_image, plane, shifted_pose

H, W = 20, 30
CASE = make_case(noise_image(H, W), plane(H, W), [shifted_pose(x=0.05 * k) for k in range(3)])


def output(depth: np.ndarray | None) -> MethodOutput:
    return MethodOutput(np.stack([noise_image(H, W, k) for k in range(3)]), frame_depth=depth)


def reloaded(given: MethodOutput, path: Path) -> MethodOutput:
    save_frames(path, given)
    record = CellRecord("d", "s", "m", "1", None, frames=frame_hashes(given.frames, (0, 1, 2)))
    found = load_frames(path, record)
    assert found is not None
    return found


def test_depth_comes_back_as_metrics_saw_it(tmp_path: Path) -> None:
    depth = np.exp(np.random.default_rng(0).uniform(-6, 9, (3, H, W))).astype(np.float32)
    given = stored_precision(output(depth))
    assert given.frame_depth is not None
    assert given.frame_depth.dtype == np.float32
    np.testing.assert_allclose(given.frame_depth, depth, rtol=5e-4)
    found = reloaded(given, tmp_path / "frames.npz").frame_depth
    assert found is not None
    np.testing.assert_array_equal(found, given.frame_depth)
    again = stored_precision(given).frame_depth
    assert again is not None
    np.testing.assert_array_equal(again, given.frame_depth)


@pytest.mark.filterwarnings("error")
def test_what_is_no_depth_is_zero(tmp_path: Path) -> None:
    depth = np.full((3, H, W), 2.0, np.float32)
    depth[0, 0, :4] = np.nan, np.inf, -1.0, 0.0
    depth[0, 0, 4] = 1e9
    found = reloaded(output(depth), tmp_path / "frames.npz").frame_depth
    assert found is not None
    assert found[0, 0, :4].tolist() == [0, 0, 0, 0]
    assert found[0, 0, 4] == np.finfo(np.float16).max
    assert (found[1:] == 2.0).all()


def test_frames_stored_without_depth_load_without(tmp_path: Path) -> None:
    assert reloaded(output(None), tmp_path / "frames.npz").frame_depth is None


@pytest.mark.parametrize("method", [WARP, WARP_TELEA])
def test_warp_baselines_give_their_depth_and_score_alike_when_reloaded(method: object, tmp_path: Path) -> None:
    fresh = stored_precision(method.run(CASE, RunOptions()))  # type: ignore[attr-defined]
    assert fresh.frame_depth is not None
    np.testing.assert_array_equal(fresh.frame_depth[0], plane(H, W))
    assert (fresh.frame_depth[2][:, -3:] == 0).any()  # what the input never showed
    scores = [
        Flicker().compute(MetricInput(CASE, given)) for given in (fresh, reloaded(fresh, tmp_path / "frames.npz"))
    ]
    assert scores[0] == scores[1]
    assert scores[0]["flicker_own_depth"].value is not None


@pytest.mark.parametrize("wrong", [np.ones((3, H, W)), np.ones((2, H, W), np.float32), np.ones((H, W), np.float32)])
def test_another_shape_or_type_is_refused(wrong: np.ndarray) -> None:
    check_output(CASE, output(np.ones((3, H, W), np.float32)))
    with pytest.raises(BadOutput, match="frame_depth"):
        check_output(CASE, replace(output(None), frame_depth=wrong))
