"""Visible-content fidelity: exact renders score high, wrong colours score what they cost, hidden parts do not count."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from bench.adapters.adapter import MethodOutput, RunOptions
from bench.adapters.warp import WARP, WARP_TELEA
from bench.datasets.case import SceneCase
from bench.metrics import sure
from bench.metrics.metric import MetricInput, Score
from bench.metrics.visible import VisiblePsnr
from bench.trajectories.trajectory import Trajectory
from bench.warping import sure_points
from orca.errors import BadInput
from tests.bench.small_cases import camera_of, make_case, noise_image, plane, shifted_pose, smooth_image

H, W = 48, 64
FOCAL = float(camera_of(H, W).K[0, 0])


def score(case: SceneCase, frames: NDArray[np.uint8], **model: Any) -> Score:
    return VisiblePsnr().compute(MetricInput(case, MethodOutput(frames, model=model)))["visible_psnr"]


def moved(pixels: float) -> NDArray[np.float64]:
    """A camera from which a plane at depth 2 lies ``pixels`` further left."""
    return shifted_pose(x=pixels * 2.0 / FOCAL)


def test_a_known_error_on_the_visible_part_is_the_score() -> None:
    """Visible part 5 levels off; the columns that the input never saw are random and must not matter."""
    image = np.clip(smooth_image(H, W), 0, 250)
    case = make_case(image, plane(H, W), [moved(6)])
    frame = noise_image(H, W)
    frame[:, :-6] = image[:, 6:] + 5
    found = score(case, frame[None])
    assert found.value == pytest.approx(20 * np.log10(255 / 5), abs=1e-3)
    assert found.n == 1


def test_an_exact_render_between_pixels_beats_a_rounded_splat() -> None:
    """Half a pixel off the grid: reading the frame at the exact position must not punish the exact render."""
    x = np.tile(np.arange(W, dtype=np.float64), (H, 1))

    def scene(dx: float) -> NDArray[np.uint8]:
        return (np.stack([127.5 + 100 * np.sin((x + dx) / 4 + k) for k in range(3)], axis=2) + 0.5).astype(np.uint8)

    case = make_case(scene(0.0), plane(H, W), [moved(6.5)])
    exact = score(case, scene(6.5)[None])
    rounded = score(case, WARP_TELEA.run(case, RunOptions()).frames)
    assert exact.value is not None
    assert rounded.value is not None
    assert exact.value > 35
    assert exact.value > rounded.value + 10


def test_worse_frames_score_lower() -> None:
    case = make_case(smooth_image(H, W), plane(H, W), [moved(6)])
    good = WARP_TELEA.run(case, RunOptions()).frames[0]
    noise = np.random.default_rng(0).normal(size=good.shape)
    values = [score(case, np.clip(good + s * noise, 0, 255).astype(np.uint8)[None]).value for s in (2, 8, 32)]
    assert values[0] is not None
    assert values[1] is not None
    assert values[2] is not None
    assert values[0] > values[1] + 6 > values[2] + 12


def test_the_wrong_camera_scores_lower() -> None:
    case = make_case(noise_image(H, W), plane(H, W), [moved(6)])
    other = make_case(case.image, case.depth, [moved(9)])
    right, wrong = (WARP.run(c, RunOptions()).frames ^ 1 for c in (case, other))
    matched, mismatched = score(case, right).value, score(case, wrong).value
    assert matched is not None
    assert mismatched is not None
    assert matched > 45
    assert mismatched < 12


def test_frames_without_enough_sure_pixels_do_not_count() -> None:
    case = make_case(noise_image(H, W), plane(H, W), [moved(6), shifted_pose(z=5.0)])
    frames = noise_image(2 * H, W, 7).reshape(2, H, W, 3)
    found = score(case, frames)
    assert found.per_frame is not None
    assert found.per_frame[0] is not None
    assert found.per_frame[1] is None
    assert found.n == 1
    assert found.detail["frames_with_too_few_sure_pixels"] == 1
    lost = make_case(case.image, case.depth, [shifted_pose(z=5.0)])
    assert score(lost, frames[:1]).reason == "no frame has at least 1% sure pixels"


def test_the_warp_baselines_are_the_reference() -> None:
    case = make_case(noise_image(H, W), plane(H, W), [moved(6)])
    for method in (WARP, WARP_TELEA):
        output = method.run(case, RunOptions())
        found = VisiblePsnr().compute(MetricInput(case, output))["visible_psnr"]
        assert (found.value, found.reason) == (None, "the warp baselines are that reference")


def test_identical_frames_have_no_finite_value() -> None:
    case = make_case(noise_image(H, W), plane(H, W), [np.eye(4)])
    assert "infinite PSNR" in str(score(case, case.image[None]).reason)


def test_frames_of_another_size_are_resized() -> None:
    case = make_case(smooth_image(H, W), plane(H, W), [np.eye(4)])
    larger = cv2.resize(case.image, (2 * W, 2 * H), interpolation=cv2.INTER_CUBIC)
    found = score(case, larger[None])
    assert found.value is not None
    assert found.value > 40


def test_a_wrong_number_of_frames_is_refused() -> None:
    case = make_case(noise_image(H, W), plane(H, W), [moved(6)])
    with pytest.raises(BadInput, match="2 frames for 1 evaluated cameras"):
        score(case, np.zeros((2, H, W, 3), np.uint8))


def test_a_scene_is_splatted_once_for_all_methods(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[int] = []

    def counted(*args: Any, **kwargs: Any) -> Any:
        calls.append(1)
        return sure_points(*args, **kwargs)

    monkeypatch.setattr(sure, "sure_points", counted)
    sure.forget_sure_masks()
    metric = VisiblePsnr()
    image, poses = noise_image(H, W), [moved(6), moved(7)]
    frames = np.zeros((2, H, W, 3), np.uint8)
    values = [
        metric.compute(MetricInput(make_case(image, plane(H, W), poses), MethodOutput(frames)))["visible_psnr"].value
        for _ in range(3)
    ]
    assert len(calls) == 2
    assert len(set(values)) == 1
    metric.compute(MetricInput(make_case(image, plane(H, W, 2.5), poses), MethodOutput(frames)))
    assert len(calls) == 4  # another depth is another splat


@pytest.mark.data
@pytest.mark.slow
def test_published_frames_score_in_the_measured_range(data_root: Path) -> None:
    """VistaDream's refined kitchen: its own cameras and depth; crude splats elsewhere measured 15 to 23 dB."""
    import av

    document = json.loads((data_root / "vistadream/cameras/kitchen.json").read_text(encoding="utf-8"))
    image = cv2.imread(str(data_root / "realmdreamer/images/kitchen.png"))[..., ::-1].copy()
    depth = cv2.imread(str(data_root / "realmdreamer/depth/kitchen.png"), cv2.IMREAD_UNCHANGED).astype(np.float32) / 1e4
    poses = np.array(document["world_to_camera"]).reshape(-1, 4, 4)
    wanted = (20, 60, 125)
    with av.open(str(data_root / "vistadream/rgb/kitchen.mp4")) as video:
        decoded = [f.to_ndarray(format="rgb24") for i, f in enumerate(video.decode(video=0)) if i in wanted]
    trajectory = Trajectory("vistadream", np.array(document["K_512"]), poses, 512, 512)
    camera = Trajectory("input", trajectory.K[:1], np.eye(4)[None], 512, 512).camera(0)
    case = SceneCase("realmdreamer", "kitchen", image, camera, depth, "", True, "", trajectory, wanted)
    right = score(case, np.stack(decoded))
    shuffled = score(case, np.stack(decoded[::-1]))
    assert right.value is not None
    assert shuffled.value is not None
    assert 18 < right.value < 30
    assert right.value > shuffled.value + 1
