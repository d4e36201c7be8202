"""TSED over ladders of damage to real textures: what moves the median distance, and what does not."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import cv2
import numpy as np

from bench.metrics.tsed_sequence import score_sequence
from orca.camera import Camera
from tests.bench.tsed_scenes import Image, camera_of, plane_homography, rotation, texture, warp

NORMAL = np.array([0.3, -0.2, 1.0]) / np.linalg.norm([0.3, -0.2, 1.0])
SIZE = 256


@cache
def clip() -> tuple[Image, list[Camera]]:
    image = texture()
    source = camera_of(image)
    cameras = [
        camera_of(image, rotation("y", 3 * k) @ rotation("x", -2 * k), (-0.2 * k, 0.05 * k, 0)).resized(SIZE, SIZE)
        for k in range(3)
    ]
    return np.stack([warp(image, plane_homography(source, c, NORMAL, 4.0), SIZE) for c in cameras]), cameras


def median(frames: Image) -> tuple[float, float]:
    """Median SED, and the smallest number of matches of a pair."""
    score = score_sequence(frames, clip()[1])
    assert score.median_sed is not None
    return score.median_sed, min(pair.n for pair in score.pairs)


def test_more_damage_moves_points_further() -> None:
    """Noise shifts key points. Holes on the screen, and blur, take matches away.

    A video that is blurred evenly is as consistent as a sharp one, so there is no ladder of distances over blur.
    """
    frames, _ = clip()
    noise = np.random.default_rng(0).normal(size=frames.shape)
    clean = median(frames)
    noisy = [median(np.clip(frames + s * noise, 0, 255).astype(np.uint8)) for s in (5, 15, 40)]
    assert clean[0] < noisy[0][0] < noisy[1][0] < noisy[2][0]
    assert clean[1] > noisy[0][1] > noisy[1][1] > noisy[2][1]
    blurred = [median(np.stack([cv2.GaussianBlur(f, (0, 0), s) for f in frames])) for s in (1.0, 2.0, 4.0, 6.0)]
    assert blurred[0][1] > blurred[1][1] > blurred[2][1] > blurred[3][1]
    assert all(distance < 0.3 for distance, _ in blurred)
    where = np.kron(np.random.default_rng(3).random((16, 16)), np.ones((16, 16)))
    holed = [median(np.where((where < s)[..., None], np.uint8(0), frames)) for s in (0.1, 0.3, 0.6)]
    assert clean[1] > holed[0][1] > holed[1][1] > holed[2][1]
    assert all(distance < 2 for distance, _ in holed[:2])  # beyond, the corners of the holes are the matches


def test_a_wobble_of_the_picture_raises_the_distance() -> None:
    """What TSED is for: every other frame is moved across the epipolar lines by more and more."""
    frames, _ = clip()

    def moved(pixels: float) -> Image:
        shaken = frames.copy()
        shaken[1] = warp(frames[1], np.array([[1, 0, 0], [0, 1, pixels], [0, 0, 1.0]]))
        return shaken

    ladder = [median(moved(pixels))[0] for pixels in (0.0, 0.5, 1.0, 2.0, 4.0)]
    assert all(a < b for a, b in pairwise(ladder))
    assert ladder[-1] > 2
