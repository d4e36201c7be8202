"""Were the frames that somebody brings rendered from the case's cameras? Frames elsewhere are not comparable."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench.datasets.case import SceneCase
from bench.trajectories import Trajectory
from orca.camera import Camera
from orca.conventions import Float64Array
from orca.errors import BadInput

__all__ = ["POSE_TOLERANCE", "frames_of_case", "input_frame"]

POSE_TOLERANCE = 1e-3  # of a rotation's entries and, in scene radii, of a translation: half a pixel at f = 500
K_TOLERANCE = 0.05  # pixels of the case


def frames_of_case(case: SceneCase, cameras: Sequence[Camera], where: str) -> tuple[int, ...]:
    """Which of the given frames are the evaluated ones, in their order.

    The cameras must be those of the whole trajectory or those of the evaluated frames, in order. They may be given in
    another world (a rotation and a translation common to all), since that moves no view, and at another resolution.

    Args:
        case: the scene with its trajectory.
        cameras: what belongs to the given frames.
        where: names their file in an error.

    Raises:
        BadInput: another number of cameras, or other views; names the first frame that differs.
    """
    for path, frames in (
        (case.trajectory, case.eval_indices),
        (case.eval_trajectory, tuple(range(len(case.eval_indices)))),
    ):
        if len(path) == len(cameras):
            _check_views(path, cameras, where)
            return frames
    raise BadInput(
        f"{len(cameras)} cameras in {where}",
        f"the {len(case.trajectory)} of trajectory '{case.trajectory.name}' or its {len(case.eval_indices)} evaluated "
        "ones, in order",
        "render along the cameras that `bench cameras` writes, and keep that file beside the frames",
    )


def input_frame(case: SceneCase, given: int) -> int | None:
    """The first of ``given`` frames (of the trajectory, or of its evaluated part) seen from the input camera."""
    path = case.trajectory if given == len(case.trajectory) else case.eval_trajectory
    same = [
        i
        for i, camera in enumerate(path.cameras())
        if np.allclose(camera.world_to_camera, case.camera.world_to_camera, atol=1e-6)
        and np.allclose(camera.K, case.camera.K, atol=1e-6)
    ]
    return same[0] if same else None


def _check_views(path: Trajectory, cameras: Sequence[Camera], where: str) -> None:
    poses = np.stack([camera.world_to_camera for camera in cameras])
    K = np.stack([camera.resized(path.width, path.height).K for camera in cameras])
    wrong = np.abs(K - path.K).max(axis=(1, 2)) > K_TOLERANCE
    for kind, gauge in (("K", wrong), ("pose", _pose_errors(path.world_to_camera, poses) > POSE_TOLERANCE)):
        if gauge.any():
            frame = int(np.argmax(gauge))
            raise BadInput(
                f"{where}: the {kind} of frame {frame} is not that of trajectory '{path.name}'{_unit(path, poses)}",
                f"the views of SHA-256 {path.sha256[:12]}, lengths in units of {path.unit}",
                "render along the cameras that `bench cameras` writes",
            )


def _pose_errors(ours: Float64Array, theirs: Float64Array) -> Float64Array:
    """Largest difference of a pose entry per frame, after the one rigid motion that makes the first frames equal."""
    moved = theirs @ np.linalg.inv(theirs[0]) @ ours[0]
    return np.asarray(np.abs(moved - ours).max(axis=(1, 2)))


def _unit(path: Trajectory, poses: Float64Array) -> str:
    """A hint for the commonest mistake: the right path in another unit of length."""
    ours, theirs = (np.linalg.inv(p)[:, :3, 3] for p in (path.world_to_camera, poses))
    spans = [float(np.linalg.norm(c - c[0], axis=1).max()) for c in (ours, theirs)]
    if min(spans) < 1e-9 or abs(spans[1] / spans[0] - 1) < 0.01:
        return ""
    scaled = poses.copy()
    scaled[:, :3, 3] *= spans[0] / spans[1]
    same = bool((_pose_errors(path.world_to_camera, scaled) < 10 * POSE_TOLERANCE).all())
    return f" (the same path {spans[1] / spans[0]:.4g} times as large: another unit)" if same else ""
