"""How fast TSED is here, as a ratio to the shape in which OpenCV invites one to write it, in one process.

A wall time says more about the machine and its neighbours than about the code. So the two ways score the same frames in
turn, the verdicts are compared pair by pair, and the ratio is what is reported.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import median
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.metrics.matching import ANGLE_RESOLUTION, MatchConfig
from bench.metrics.sift import Features, detect
from bench.metrics.tsed_config import TsedConfig
from bench.metrics.tsed_pair import PairMatches, PairScore
from bench.metrics.tsed_sequence import judge_pairs, match_consecutive
from orca.camera import Camera
from orca.conventions import Float32Array, Float64Array, UInt8Array
from orca.errors import BadInput

__all__ = ["TsedSpeed", "match_naively", "measure_tsed_speed"]


@dataclass(frozen=True)
class TsedSpeed:
    """Seconds of both ways on the same frames, one entry a repeat.

    Attributes:
        frames: number of frames.
        width, height: of a frame, pixels.
        threads: worker threads of the fast way; OpenCV chooses its own for the naive one.
        seconds: wall time of the way the metric goes.
        naive_seconds: the same for detection of both frames of every pair and the brute-force matcher.
        cpu_seconds, naive_cpu_seconds: processor time of all threads, which a busy machine distorts less.
        differing_pairs: pairs whose verdict, reason or model differ between the two; 0 is the only good answer.
    """

    frames: int
    width: int
    height: int
    threads: int
    seconds: tuple[float, ...]
    naive_seconds: tuple[float, ...]
    cpu_seconds: tuple[float, ...]
    naive_cpu_seconds: tuple[float, ...]
    differing_pairs: int

    @property
    def ratio(self) -> float:
        """Median over the repeats of naive / fast."""
        return median(slow / fast for slow, fast in zip(self.naive_seconds, self.seconds, strict=True))

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "what": "tsed",
            "against": "naive OpenCV: SIFT on both frames of every pair, BFMatcher both ways",
            "frames": self.frames,
            "width": self.width,
            "height": self.height,
            "threads": self.threads,
            "seconds": list(self.seconds),
            "naive_seconds": list(self.naive_seconds),
            "cpu_seconds": list(self.cpu_seconds),
            "naive_cpu_seconds": list(self.naive_cpu_seconds),
            "ratio": self.ratio,
            "differing_pairs": self.differing_pairs,
            "opencv": cv2.__version__,
        }


def measure_tsed_speed(
    frames: UInt8Array,
    cameras: Sequence[Camera],
    config: TsedConfig | None = None,
    threads: int = 2,
    repeats: int = 1,
) -> TsedSpeed:
    """Score the frames both ways in turn, ``repeats`` times, and compare the verdicts.

    Args:
        frames: [n, H, W, 3] uint8, two or more.
        cameras: one a frame.
        config: settings; the reference's when left out.
        threads: worker threads of the fast way.
        repeats: how many times each way runs.

    Raises:
        BadInput: for fewer than two frames, another number of cameras, or no repeat.
    """
    c = config or TsedConfig()
    if len(frames) < 2 or len(frames) != len(cameras) or repeats < 1:
        raise BadInput(
            f"{len(frames)} frames, {len(cameras)} cameras, {repeats} repeats",
            "two frames or more, one camera each, one repeat or more",
            "give more frames",
        )
    height, width = frames.shape[1:3]
    sized = [camera.resized(width, height) for camera in cameras]

    fast, naive = [], []
    differing = 0
    for _ in range(repeats):
        fast.append(_timed(lambda: match_consecutive(frames, c, threads), sized, c))
        naive.append(_timed(lambda: match_naively(frames, c), sized, c))
        pairs = zip(fast[-1].pairs, naive[-1].pairs, strict=True)
        differing = max(differing, sum(not _same(c, p, q, width) for p, q in pairs))
    return TsedSpeed(
        frames=len(frames),
        width=width,
        height=height,
        threads=threads,
        seconds=tuple(run.wall for run in fast),
        naive_seconds=tuple(run.wall for run in naive),
        cpu_seconds=tuple(run.cpu for run in fast),
        naive_cpu_seconds=tuple(run.cpu for run in naive),
        differing_pairs=differing,
    )


@dataclass(frozen=True)
class _Run:
    wall: float
    cpu: float
    pairs: tuple[PairScore, ...]


def _timed(match: Callable[[], Sequence[PairMatches]], cameras: Sequence[Camera], config: TsedConfig) -> _Run:
    """One scoring of the sequence, from pixels to verdicts."""
    started, cpu = time.perf_counter(), time.process_time()
    pairs = judge_pairs(match(), cameras, config)
    return _Run(time.perf_counter() - started, time.process_time() - cpu, pairs)


def match_naively(frames: UInt8Array, config: TsedConfig | None = None) -> tuple[PairMatches, ...]:
    """Matches of frames i and i + 1 as OpenCV's tutorials find them: the same set, slowly.

    Both frames of every pair are detected anew; the brute-force matcher looks for the two nearest in each direction.
    """
    c = config or TsedConfig()
    found = []
    for first, second in pairwise(frames):
        a, b = detect(first, c.sift), detect(second, c.sift)
        found.append(_brute_force(a, b, c.matcher))
    return tuple(found)


def _brute_force(a: Features, b: Features, config: MatchConfig) -> PairMatches:
    if len(a) == 0 or len(b) == 0:
        return PairMatches(np.zeros((0, 2)), np.zeros((0, 2)))
    forward, passes = _nearest(a.descriptors, b.descriptors, config)
    backward, passes_back = _nearest(b.descriptors, a.descriptors, config)
    mutual = backward[forward] == np.arange(len(a))
    i = np.flatnonzero(mutual & passes & passes_back[forward])
    return PairMatches(a.points[i], b.points[forward[i]])


def _nearest(
    queries: Float32Array, train: Float32Array, config: MatchConfig
) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Index of the nearest of ``train`` for each query, and whether it passes the angle and the ratio test."""
    pairs = cv2.BFMatcher(cv2.NORM_L2).knnMatch(queries, train, k=2)
    nearest = np.array([pair[0].trainIdx for pair in pairs], np.intp)
    best = _angle(np.array([pair[0].distance for pair in pairs]))
    second = _angle(np.array([pair[1].distance if len(pair) > 1 else np.inf for pair in pairs]))
    ratio = np.maximum(best, ANGLE_RESOLUTION) < config.ratio * np.maximum(second, ANGLE_RESOLUTION)
    return nearest, (best <= config.max_angle) & ratio


def _angle(distance: Float64Array) -> Float64Array:
    """Angle between unit vectors from their distance, 2 arcsin(d / 2); infinite where there is no neighbour."""
    angle = 2 * np.arcsin(np.clip(distance / 2, 0.0, 1.0))
    return np.where(np.isinf(distance), np.inf, angle)


def _same(config: TsedConfig, fast: PairScore, naive: PairScore, width: int) -> bool:
    """Equal verdict, reason and model over the whole grid of thresholds."""
    errors = [config.t_error * width / (config.t_error_width or width), *config.curve_errors]
    grid = [(t, n) for t in errors for n in (config.t_matches, *config.curve_matches)]
    return fast.model == naive.model and all(fast.reason(t, n) == naive.reason(t, n) for t, n in grid)
