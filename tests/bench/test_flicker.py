"""Flicker: zero where nothing changes, the injected change where something does, occlusions left out, reasons."""

from __future__ import annotations

import json
from itertools import pairwise

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from bench.adapters.adapter import MethodOutput
from bench.datasets.case import SceneCase
from bench.metrics.flicker import NO_DEPTH, Flicker
from bench.metrics.metric import MetricInput, Score
from bench.metrics.tsed import Tsed
from bench.trajectories.trajectory import Trajectory
from orca.camera import Camera
from orca.errors import BadInput
from tests.bench.small_cases import camera_of, make_case, noise_image, plane, shifted_pose, smooth_image
from tests.bench.tsed_scenes import Image, plane_homography, pose, texture, warp

H, W = 48, 64
FOCAL = float(camera_of(H, W).K[0, 0])
STILL = [np.eye(4)] * 4
BOTH = ("flicker", "flicker_own_depth")


def scores(
    case: SceneCase,
    frames: NDArray[np.uint8],
    depth: NDArray[np.float32] | None = None,
    coverage: NDArray[np.float32] | None = None,
) -> dict[str, Score]:
    return Flicker().compute(MetricInput(case, MethodOutput(frames, coverage=coverage, frame_depth=depth)))


def still_case(image: NDArray[np.uint8] | None = None) -> SceneCase:
    return make_case(noise_image(H, W) if image is None else image, plane(H, W), STILL)


def values(case: SceneCase, frames: NDArray[np.uint8], depth: NDArray[np.float32] | None = None) -> list[float]:
    depth = np.stack([plane(H, W)] * len(frames)) if depth is None else depth
    found = scores(case, frames, depth)
    numbers = [found[name].value for name in BOTH]
    assert None not in numbers
    return [float(x) for x in numbers if x is not None]


def textured_plane(steps: int = 4) -> tuple[SceneCase, Image, NDArray[np.float32]]:
    """A photograph on a slanted plane, seen by a moving camera: exact frames, depths and cameras, 128x128."""
    image = cv2.resize(texture(), (128, 128), interpolation=cv2.INTER_AREA)
    camera = camera_of(128, 128)
    normal, distance = np.array([0.3, -0.2, 1.0]) / np.linalg.norm([0.3, -0.2, 1.0]), 4.0
    poses = [shifted_pose(0.05 * k, 0.02 * k, 0.03 * k) for k in range(steps)]
    cameras = [Camera(camera.K, p, 128, 128) for p in poses]
    frames = np.stack([warp(image, plane_homography(camera, c, normal, distance)) for c in cameras])
    depths = []
    for c in cameras:
        # The plane n.X = d in the camera at C: n.(C + z r) = d.
        z = (distance - normal @ c.center) / (c.rays() @ normal)
        depths.append(z.reshape(128, 128).astype(np.float32))
    return make_case(image, depths[0], poses), frames, np.stack(depths)


def test_a_static_scene_has_none() -> None:
    image = noise_image(H, W)
    assert values(still_case(image), np.stack([image] * 4)) == [0.0, 0.0]


def test_hand_value_of_a_brightness_that_pumps() -> None:
    """100, 106, 100, 106: every pair differs by 6 levels everywhere, whatever the smoothing."""
    frames = np.stack([np.full((H, W, 3), 100 + 6 * (k % 2), np.uint8) for k in range(4)])
    assert values(still_case(), frames) == pytest.approx([6.0, 6.0], abs=1e-4)


def test_an_exact_video_of_a_photograph_has_almost_none() -> None:
    case, frames, depths = textured_plane()
    found = scores(case, frames, depths)
    for name in BOTH:
        assert found[name].value is not None
        assert found[name].value < 1.5  # type: ignore[operator]
        assert found[name].n == 3
    # The same video by wrong cameras: read without moving.
    wrong = scores(make_case(case.image, case.depth, STILL), frames, depths)["flicker"].value
    assert wrong > 3 * found["flicker"].value  # type: ignore[operator]


@pytest.mark.parametrize("kind", ["brightness", "noise", "holes"])
def test_more_injected_flicker_scores_higher(kind: str) -> None:
    case, frames, depths = textured_plane()
    rng = np.random.default_rng(0)
    noise, where = rng.normal(size=frames.shape), rng.random(frames.shape[:3])
    sign = np.array([1, -1, 1, -1])[:, None, None, None]

    def damaged(level: float) -> NDArray[np.uint8]:
        if kind == "holes":
            return np.where((where < level / 40)[..., None], np.uint8(0), frames)
        change = level * (sign if kind == "brightness" else noise)
        return np.clip(frames + change, 0, 255).round().astype(np.uint8)

    for name in BOTH:
        ladder = [scores(case, damaged(level), depths)[name].value for level in (0, 2, 4, 8, 16)]
        assert all(a < b for a, b in pairwise(ladder)), ladder  # type: ignore[operator]


def test_blur_lowers_it_so_it_is_never_read_alone() -> None:
    """No ladder over blur: a grey video does not flicker. Stated in the module's first lines."""
    case, frames, depths = textured_plane()
    noisy = np.clip(frames + np.random.default_rng(0).normal(0, 8, frames.shape), 0, 255).astype(np.uint8)
    blurred = np.stack([cv2.GaussianBlur(f, (0, 0), 3) for f in noisy])
    for name in BOTH:
        assert scores(case, blurred, depths)[name].value < scores(case, noisy, depths)[name].value  # type: ignore[operator]
    grey = np.full_like(frames, 128)
    assert values_of(scores(case, grey, depths)) == pytest.approx([0.0, 0.0], abs=1e-4)


def values_of(found: dict[str, Score]) -> list[float | None]:
    return [found[name].value for name in BOTH]


def two_layers(step_px: float = 6.0) -> tuple[SceneCase, NDArray[np.uint8], NDArray[np.float32]]:
    """A dark square at depth 2 that slides over a bright wall at depth 4; the wall moves half as fast."""
    frames, depths, poses = [], [], []
    for k in range(4):
        shift = step_px * k
        frame, depth = np.full((H, W, 3), 200, np.uint8), np.full((H, W), 4.0, np.float32)
        columns = slice(30 - round(shift), 46 - round(shift))
        frame[16:32, columns], depth[16:32, columns] = 40, 2.0
        frames.append(frame)
        depths.append(depth)
        poses.append(shifted_pose(shift * 2.0 / FOCAL))
    return make_case(frames[0], depths[0], poses), np.stack(frames), np.stack(depths)


def test_occluded_points_are_left_out() -> None:
    case, frames, depths = two_layers()
    found = scores(case, frames, depths)
    own = found["flicker_own_depth"]
    assert own.value is not None
    assert own.value < 2.5  # smoothing mixes the two layers within a pixel or two of the silhouette
    assert own.detail["occluded_share"] > 0.003
    assert own.detail["contradicted_share"] == 0.0
    # Told that nothing stands in front of anything, the same frames flicker.
    flat = scores(case, frames, np.full_like(depths, 4.0))["flicker_own_depth"]
    assert flat.value is not None
    assert flat.value > 3 * own.value
    assert flat.detail["occluded_share"] == 0.0
    assert found["flicker"].value < 2.5  # type: ignore[operator]


def test_a_surface_seen_through_is_counted_apart() -> None:
    """A square that is in the depth of one frame and gone from the next contradicts itself; it is not an occlusion."""
    image = noise_image(H, W)
    depths = np.stack([plane(H, W, 4.0)] * 2)
    depths[0, 16:32, 20:40] = 2.0
    found = scores(make_case(image, plane(H, W), STILL[:2]), np.stack([image] * 2), depths)["flicker_own_depth"]
    assert found.detail["contradicted_share"] > 0.05
    assert found.detail["occluded_share"] == 0.0


def test_sees_what_tsed_cannot() -> None:
    """The picture slides along the epipolar lines of a sideways step: TSED is 1 at 0.1 px, flicker is not fooled."""
    image = texture()[:256, :256]
    camera = camera_of(256, 256)
    trajectory = Trajectory("slide", camera.K, np.stack([pose(t=(-0.02 * k, 0, 0)) for k in range(3)]), 256, 256)
    parallax = camera.K[0, 0] * 0.02 / 4.0

    def video(px_a_step: float) -> Image:
        return np.stack([warp(image, np.array([[1, 0, -px_a_step * k], [0, 1, 0], [0, 0, 1.0]])) for k in range(3)])

    depth = np.full((256, 256), 4.0, np.float32)
    case = SceneCase("d", "s", image, camera, depth, "exact", True, "exact", trajectory, (0, 1, 2))
    right, swimming = video(parallax), video(parallax + 8)
    for frames in (right, swimming):
        judged = Tsed().compute(MetricInput(case, MethodOutput(frames)))
        assert judged["tsed"].value == 1.0
        assert judged["tsed_median_sed"].value < 0.2  # type: ignore[operator]
    depths = np.stack([depth] * 3)
    for name in BOTH:
        good, bad = scores(case, right, depths)[name].value, scores(case, swimming, depths)[name].value
        assert good is not None
        assert bad is not None
        assert bad > 8 * good


def test_missing_depth_and_single_frames_give_reasons() -> None:
    image = smooth_image(H, W)
    without = scores(still_case(image), np.stack([image] * 4))
    assert without["flicker"].value == 0.0
    assert (without["flicker_own_depth"].value, without["flicker_own_depth"].reason) == (None, NO_DEPTH)
    one = scores(make_case(image, plane(H, W), STILL[:1]), image[None])
    assert {score.reason for score in one.values()} == {"fewer than two frames"}


@pytest.mark.parametrize("empty", [0.0, np.nan, np.inf, -1.0])
def test_a_depth_that_is_none_anywhere_gives_a_reason(empty: float) -> None:
    found = scores(still_case(), np.zeros((4, H, W, 3), np.uint8), np.full((4, H, W), empty, np.float32))
    assert found["flicker_own_depth"].value is None
    assert "no pair of frames" in str(found["flicker_own_depth"].reason)
    assert found["flicker_own_depth"].detail["pairs_with_too_few_points"] == 3


def test_nan_in_part_of_the_depth_leaves_that_part_out() -> None:
    frames = np.stack([np.full((H, W, 3), 100, np.uint8)] * 4)
    frames[1::2, :, : W // 2] = 200
    depths = np.stack([plane(H, W)] * 4)
    depths[:, :, : W // 2 + 6] = np.nan
    found = scores(still_case(), frames, depths)["flicker_own_depth"]
    assert found.value == pytest.approx(0.0, abs=1e-3)
    assert found.detail["compared_share"][0] < 0.5


def test_transparent_pixels_are_no_surface() -> None:
    frames = np.stack([np.full((H, W, 3), 100, np.uint8)] * 4)
    frames[1::2, :, : W // 2] = 200
    coverage = np.ones((4, H, W), np.float32)
    coverage[:, :, : W // 2 + 6] = 0.2
    found = scores(still_case(), frames, np.stack([plane(H, W)] * 4), coverage)["flicker_own_depth"]
    assert found.value == pytest.approx(0.0, abs=1e-3)


def test_cameras_that_share_nothing_give_a_reason() -> None:
    case = make_case(noise_image(H, W), plane(H, W), [np.eye(4), shifted_pose(z=5.0)])
    found = scores(case, np.zeros((2, H, W, 3), np.uint8), np.stack([plane(H, W)] * 2))
    assert all(score.value is None and "no pair of frames" in str(score.reason) for score in found.values())
    json.dumps([score.detail for score in found.values()], allow_nan=False)


def test_frames_of_another_size_are_brought_to_their_cameras() -> None:
    case, frames, depths = textured_plane()
    smaller = np.stack([cv2.resize(f, (96, 96), interpolation=cv2.INTER_AREA) for f in frames])
    shrunk = np.stack([cv2.resize(d, (96, 96), interpolation=cv2.INTER_AREA) for d in depths])
    for score in scores(case, smaller, shrunk).values():
        assert score.value is not None
        assert score.value < 1.5


def test_wrong_numbers_and_shapes_are_refused() -> None:
    frames = np.zeros((4, H, W, 3), np.uint8)
    with pytest.raises(BadInput, match="3 frames for 4 evaluated cameras"):
        scores(still_case(), frames[:3])
    for depth in (np.ones((3, H, W)), np.ones((4, H, W - 1)), np.ones((H, W))):
        with pytest.raises(BadInput, match="depth of shape"):
            scores(still_case(), frames, depth.astype(np.float32))


def test_detail_is_json() -> None:
    case, frames, depths = two_layers()
    for score in scores(case, frames, depths).values():
        json.dumps(score.detail, allow_nan=False)
        assert len(score.detail["compared_share"]) == 3
