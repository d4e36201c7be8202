"""The naive way to TSED: the same matches and verdicts as the fast one; what the speed record says. No timed claims."""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pytest

from bench.metrics.tsed_config import TsedConfig
from bench.metrics.tsed_sequence import match_consecutive
from bench.metrics.tsed_speed import TsedSpeed, match_naively, measure_tsed_speed
from orca.camera import Camera
from orca.errors import BadInput
from tests.bench.tsed_scenes import Image, camera_of, plane_homography, rotation, texture, warp

NORMAL = np.array([0.3, -0.2, 1.0]) / np.linalg.norm([0.3, -0.2, 1.0])


@cache
def clip() -> tuple[Image, list[Camera]]:
    """Two good pairs of a plane in motion, one to a black frame, one from it."""
    image = texture()
    cameras = [camera_of(image, rotation("y", 2 * k), (-0.15 * k, 0.02 * k, 0.0)).resized(256, 256) for k in range(5)]
    frames = np.stack([warp(image, plane_homography(camera_of(image), c, NORMAL, 4.0), 256) for c in cameras])
    frames[3] = 0
    return frames, cameras


def test_naive_and_fast_find_the_same_matches() -> None:
    frames, _ = clip()
    for fast, naive in zip(match_consecutive(frames, TsedConfig()), match_naively(frames), strict=True):
        np.testing.assert_array_equal(fast.x1, naive.x1)
        np.testing.assert_array_equal(fast.x2, naive.x2)


def test_a_measurement_compares_verdicts() -> None:
    frames, cameras = clip()
    found = measure_tsed_speed(frames, cameras, repeats=2)
    assert found.differing_pairs == 0
    assert (found.frames, found.width, found.height, found.threads) == (5, 256, 256, 2)
    assert len(found.seconds) == len(found.naive_seconds) == len(found.cpu_seconds) == 2
    json.dumps(found.to_json(), allow_nan=False)


def test_differing_verdicts_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    frames, cameras = clip()
    monkeypatch.setattr("bench.metrics.tsed_speed.match_naively", lambda f, c: match_consecutive(f[::-1], c))
    assert measure_tsed_speed(frames, cameras).differing_pairs > 0


def test_the_ratio_is_the_median_of_paired_ratios() -> None:
    record = TsedSpeed(50, 512, 512, 2, (1.0, 2.0, 4.0), (3.0, 10.0, 16.0), (), (), 0)
    assert record.ratio == 4.0


@pytest.mark.parametrize("kept", [0, 1])
def test_too_few_frames_are_refused(kept: int) -> None:
    frames, cameras = clip()
    with pytest.raises(BadInput, match="two frames or more"):
        measure_tsed_speed(frames[:kept], cameras[:kept])
    with pytest.raises(BadInput, match="2 cameras"):
        measure_tsed_speed(frames, cameras[:2])


def test_frames_without_features_match_nothing() -> None:
    assert [len(pair) for pair in match_naively(np.zeros((3, 64, 64, 3), np.uint8))] == [0, 0]
    assert match_naively(np.zeros((0, 64, 64, 3), np.uint8)) == ()
