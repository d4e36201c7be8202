"""Cases of the cameras: paths that go nowhere, leave the scene, or are no paths."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bench.adapters.adapter import MethodOutput
from bench.datasets.case import SceneCase
from bench.stability.case import StabilityCase
from bench.stability.outcome import DEGRADED, FINISHED, TYPED
from bench.stability.scenes import FRAMES, SIZE, make_scene, turn
from bench.trajectories import Trajectory
from orca.camera import Camera
from orca.conventions import Float64Array
from orca.paths import make_path

__all__ = ["CAMERA_CASES"]

_SAME_VIEW = 2.0  # of 255: mean difference between two renders of one camera


def same_views(case: SceneCase, output: MethodOutput) -> str | None:
    """Frames of one camera look the same."""
    first = output.frames[0].astype(float)
    worst = max(float(np.abs(frame - first).mean()) for frame in output.frames)
    return f"views of one camera differ by {worst:.1f} levels" if worst > _SAME_VIEW else None


def still(frames: int) -> Float64Array:
    """The input camera, again and again."""
    return np.tile(np.eye(4), (frames, 1, 1))


def shifted(offsets: Float64Array) -> Float64Array:
    """Camera centres [F, 3] without any turning."""
    poses = np.tile(np.eye(4), (len(offsets), 1, 1))
    poses[:, :3, 3] = -offsets
    return poses


def sideways(distance: float) -> Float64Array:
    """From the input camera to the right."""
    return shifted(np.outer(np.linspace(0, distance, FRAMES), [1.0, 0.0, 0.0]))


def into(distance: float) -> Float64Array:
    """From the input camera straight ahead, through whatever is there."""
    return shifted(np.outer(np.linspace(0, distance, FRAMES), [0.0, 0.0, 1.0]))


def rolled() -> Float64Array:
    """Turned about the optical axis, up to a quarter turn."""
    poses = np.tile(np.eye(4), (FRAMES, 1, 1))
    for pose, angle in zip(poses, np.radians(np.linspace(0, 90, FRAMES)), strict=True):
        pose[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return poses


def with_nan() -> Float64Array:
    """A path with one value that is no number."""
    poses = make_path("swing", FRAMES)
    poses[2, 0, 3] = np.nan
    return poses


def stretched() -> Float64Array:
    """Poses that scale the world by two along x."""
    poses = make_path("swing", FRAMES)
    poses[1:, 0, :3] *= 2.0
    return poses


def mirror() -> Float64Array:
    """Poses that exchange left and right."""
    poses = make_path("swing", FRAMES)
    poses[1:, 0] *= -1.0
    return poses


def _seen_with(hfov_deg: float) -> SceneCase:
    return make_scene(camera=Camera.from_fov(SIZE, SIZE, hfov_deg))


def _off_centre() -> SceneCase:
    K = np.array([[110.0, 0, 4 * SIZE], [0, 110.0, SIZE / 2], [0, 0, 1]])
    return make_scene(camera=Camera(K, np.eye(4), SIZE, SIZE))


def _zoomed() -> SceneCase:
    """The path's cameras have a tenth of the input's focal length."""
    camera = Camera.from_fov(SIZE, SIZE, 60.0)
    K = np.tile(camera.K, (FRAMES, 1, 1))
    K[:, 0, 0] *= 0.1
    K[:, 1, 1] *= 0.1
    return make_scene(trajectory=Trajectory("stability", K, make_path("swing", FRAMES), SIZE, SIZE))


def _path(
    name: str,
    about: str,
    poses: Callable[[], Float64Array],
    expected: tuple[str, ...] = FINISHED,
    check: Callable[[SceneCase, MethodOutput], str | None] | None = None,
) -> StabilityCase:
    return StabilityCase(name, "cameras", about, expected, scene=lambda _: make_scene(poses=poses()), check=check)


def _scene(name: str, about: str, scene: Callable[[], SceneCase]) -> StabilityCase:
    return StabilityCase(name, "cameras", about, FINISHED, scene=lambda _: scene())


_LEAVES = (DEGRADED,)
_REFUSED = (TYPED,)

CAMERA_CASES = (
    _path("one-camera", "a path of one camera", lambda: still(1)),
    _path("no-baseline", "a path that stays at the input view", lambda: still(FRAMES), check=same_views),
    _path(
        "repeated-camera", "one new camera, again and again", lambda: sideways(0.1)[-1:].repeat(4, 0), check=same_views
    ),
    _path("long-baseline", "sideways by 100 scene radii", lambda: sideways(100.0), _LEAVES),
    _path("leaves-scene", "sideways by 3 scene radii", lambda: sideways(3.0), _LEAVES),
    _path("inside-geometry", "straight through the object and the wall behind it", lambda: into(1.6), _LEAVES),
    _path("looks-away", "cameras that look in the opposite direction", lambda: turn(180.0)[-1:].repeat(3, 0), _LEAVES),
    _path("turns-round", "a turn on the spot by 180 degrees", lambda: turn(180.0), _LEAVES),
    _path("rolls", "a quarter turn about the optical axis", rolled),
    _scene("narrow-view", "a field of view of 2 degrees", lambda: _seen_with(2.0)),
    _scene("wide-view", "a field of view of 165 degrees", lambda: _seen_with(165.0)),
    _scene("off-centre", "a principal point four image widths to the right", _off_centre),
    _scene("other-focal", "a path with a tenth of the input's focal length", _zoomed),
    _path("nan-pose", "a pose with a NaN", with_nan, _REFUSED),
    _path("stretched-pose", "poses that stretch the world", stretched, _REFUSED),
    _path("mirrored-pose", "poses that exchange left and right", mirror, _REFUSED),
    _path("no-cameras", "a path without a camera", lambda: still(0), _REFUSED),
)
