"""Camera paths in closed form: world-to-camera poses [F, 4, 4], OpenCV axes, the input camera being the identity.

Every path begins at the input view. Extents are stated in units of the scene radius R; the argument ``radius`` is the
length of R in the units of the scene, so ``radius=1`` gives poses in R. `PATHS` names each path with its defaults.
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from orca.camera import Camera
from orca.conventions import Float64Array
from orca.errors import BadInput, Unknown

__all__ = [
    "PATHS",
    "CameraPath",
    "back",
    "dolly",
    "forward",
    "look_at_pose",
    "make_path",
    "orbit",
    "path_cameras",
    "scene_radius",
    "spiral",
    "swing",
    "vistadream",
]


def scene_radius(depth: NDArray[np.floating], camera: Camera) -> float:
    """R: the mean over x, y and z of the 5..95 percentile range of the lifted input points.

    Args:
        depth: z-depth of the input view, [H, W], positive and finite.
        camera: the input camera, of the same size; its pose does not matter.

    Raises:
        BadInput: another size, a depth that is not positive and finite, or points without extent.
    """
    z = np.asarray(depth, np.float64)
    if z.shape != (camera.height, camera.width) or not (np.isfinite(z).all() and (z > 0).all()):
        raise BadInput(
            f"a depth map of shape {z.shape}, not positive and finite everywhere, or not of the camera's size",
            f"positive finite z-depth of shape ({camera.height}, {camera.width})",
            "fill the invalid pixels and resize the map to the image",
        )
    local = Camera(camera.K, np.eye(4), camera.width, camera.height)
    low, high = np.percentile(local.rays() * z.reshape(-1, 1), [5.0, 95.0], axis=0)
    radius = float(np.mean(high - low))
    if not radius > 0:
        raise BadInput(
            f"a depth map of {z.shape[1]}x{z.shape[0]} pixels whose points have no extent",
            "an image of more than one pixel",
            "use a larger image",
        )
    return radius


def _phase(frames: int) -> Float64Array:
    """t = i / (frames - 1), [F]."""
    if frames < 2:
        raise BadInput(f"a path of {frames} frames", "2 frames or more", "ask for more frames")
    return np.arange(frames) / (frames - 1)


def _look(position: Float64Array, target: Float64Array) -> Float64Array:
    """[right, down, forward] as columns, [F, 3, 3], for a viewer at ``position`` [F, 3] who looks at ``target``."""
    ahead = target - position
    ahead = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
    right = np.cross(np.array([0.0, 1.0, 0.0]), ahead)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    return np.stack([right, np.cross(ahead, right), ahead], axis=2)


def look_at_pose(center: Float64Array, target: Float64Array) -> Float64Array:
    """World-to-camera poses [F, 4, 4] of cameras at ``center`` [F, 3] looking at ``target`` [3], y staying down."""
    rotation = np.swapaxes(_look(center, np.broadcast_to(target, center.shape)), 1, 2)
    return _pose(rotation, center)


def _pose(rotation: Float64Array, center: Float64Array) -> Float64Array:
    pose = np.tile(np.eye(4), (len(center), 1, 1))
    pose[:, :3, :3] = rotation
    pose[:, :3, 3] = -np.einsum("fij,fj->fi", rotation, center)
    return pose


def _straight(center: Float64Array) -> Float64Array:
    return _pose(np.tile(np.eye(3), (len(center), 1, 1)), center)


def _along(z: Float64Array) -> Float64Array:
    zero = np.zeros_like(z)
    return _straight(np.stack([zero, zero, z], axis=1))


def vistadream(
    frames: int = 250,
    radius: float = 1.0,
    forward_ratio: float = 0.2,
    backward_ratio: float = 0.8,
    rot_ratio: float = 0.3,
    look_at_ratio: float = 0.5,
) -> Float64Array:
    """The path of VistaDream's published videos (Wang et al., ICCV 2025), 20 frames a second.

    The method uses [right, down, forward | position] directly as world-to-camera, without inverting it, and plays the
    list backwards; so does this. First and last frame are the input view.

    Args:
        frames: F.
        radius: scene radius R, in scene units.
        forward_ratio: factor on the position's z where it is negative (0.2 for most published scenes).
        backward_ratio: factor on the position's z where it is positive.
        rot_ratio: lateral extent in R, and the ratio of vertical to lateral extent.
        look_at_ratio: distance of the fixation point in R.
    """
    t = _phase(frames)
    r = rot_ratio * radius * np.sin(2 * np.pi * t)
    theta = 2 * np.pi * t * frames
    z = np.where(r > 0, -r * forward_ratio, -r * backward_ratio)
    position = np.stack([r * np.cos(theta), rot_ratio * r * np.sin(theta), z], axis=1)
    pose = np.tile(np.eye(4), (frames, 1, 1))
    pose[:, :3, :3] = _look(position, np.broadcast_to([0.0, 0.0, look_at_ratio * radius], position.shape))
    pose[:, :3, 3] = position
    return pose[::-1].copy()


def spiral(
    frames: int = 99, radius: float = 1.0, extent: float = 0.15, turns: float = 2.0, look_at: float = 1.0
) -> Float64Array:
    """Winds out of the input view and back: extent R to the side, half that up and down and in depth; fixates look_at.

    center = e sin(pi t) (cos 2 pi turns t, 0.5 sin 2 pi turns t, 0.5 sin 2 pi t), target (0, 0, look_at), times R.
    """
    t = _phase(frames)
    grow, angle = np.sin(np.pi * t), 2 * np.pi * turns * t
    unit = np.stack([np.cos(angle), 0.5 * np.sin(angle), 0.5 * np.sin(2 * np.pi * t)], axis=1)
    return look_at_pose(extent * radius * grow[:, None] * unit, np.array([0.0, 0.0, look_at * radius]))


def orbit(frames: int = 99, radius: float = 1.0, angle_deg: float = 15.0, look_at: float = 1.0) -> Float64Array:
    """Turns about the vertical axis through (0, 0, look_at R): angle_deg to the right, to the left, and home."""
    if not 0 < angle_deg < 180:
        raise BadInput(f"an orbit of {angle_deg:g} degrees", "more than 0 and less than 180", "give another angle")
    angle = np.radians(angle_deg) * np.sin(2 * np.pi * _phase(frames))
    distance = look_at * radius
    center = distance * np.stack([np.sin(angle), np.zeros(frames), 1.0 - np.cos(angle)], axis=1)
    return look_at_pose(center, np.array([0.0, 0.0, distance]))


def swing(frames: int = 99, radius: float = 1.0, extent: float = 0.15, look_at: float = 1.0) -> Float64Array:
    """A lying eight across the optical axis: extent R to either side, a third of it up and down; fixates look_at."""
    t = _phase(frames)
    unit = np.stack([np.sin(2 * np.pi * t), np.sin(4 * np.pi * t) / 3, np.zeros(frames)], axis=1)
    return look_at_pose(extent * radius * unit, np.array([0.0, 0.0, look_at * radius]))


def dolly(frames: int = 99, radius: float = 1.0, extent: float = 0.2) -> Float64Array:
    """In by extent R, out by as much behind the input view, and home; the view direction does not turn."""
    return _along(extent * radius * np.sin(2 * np.pi * _phase(frames)))


def forward(frames: int = 50, radius: float = 1.0, extent: float = 0.2) -> Float64Array:
    """Straight in by extent R, one way."""
    return _along(extent * radius * _phase(frames))


def back(frames: int = 50, radius: float = 1.0, extent: float = 0.2) -> Float64Array:
    """Straight out by extent R, one way: uncovers the border of the image."""
    return _along(-extent * radius * _phase(frames))


class _Generator(Protocol):
    def __call__(self, frames: int, radius: float) -> Float64Array: ...


@dataclass(frozen=True)
class CameraPath:
    """A path with a name.

    Attributes:
        generate: (frames, radius) -> world_to_camera [F, 4, 4], with the extents that ``description`` states.
        frames: how many frames it has unless told otherwise.
        description: one line for a list.
    """

    generate: _Generator
    frames: int
    description: str


PATHS: dict[str, CameraPath] = {
    "vistadream": CameraPath(vistadream, 250, "VistaDream's published path: 0.3 R, 250 frames, starts and ends home"),
    "spiral": CameraPath(spiral, 99, "two turns, 0.15 R to the side, up to 0.075 R up and in depth, fixates 1 R"),
    "orbit": CameraPath(orbit, 99, "15 degrees to either side about the point 1 R ahead"),
    "swing": CameraPath(swing, 99, "lying eight, 0.15 R to the side, 0.05 R up and down, fixates 1 R"),
    "dolly": CameraPath(dolly, 99, "0.2 R in, 0.2 R out behind the input view, no turning"),
    "forward": CameraPath(forward, 50, "0.2 R straight in, one way"),
    "back": CameraPath(back, 50, "0.2 R straight out, one way"),
}


def make_path(name: str, frames: int | None = None, radius: float = 1.0) -> Float64Array:
    """World-to-camera poses [F, 4, 4] of a named path.

    Args:
        name: one of `PATHS`.
        frames: F; the path's own number when left out.
        radius: length of the scene radius R in scene units.

    Raises:
        Unknown: no such path; the message names the nearest one.
        BadInput: fewer than 2 frames.
    """
    if name not in PATHS:
        near = difflib.get_close_matches(name, PATHS, n=1, cutoff=0.5)
        fix = f"did you mean '{near[0]}'?" if near else "choose one trajectory of the list, or give a .json file"
        raise Unknown(f"unknown trajectory '{name}'", ", ".join(PATHS), fix)
    path = PATHS[name]
    return path.generate(path.frames if frames is None else frames, radius)


def path_cameras(poses: Float64Array, camera: Camera) -> tuple[Camera, ...]:
    """One camera per pose, with the intrinsics and size of ``camera``. Poses [F, 4, 4] are world-to-camera."""
    return tuple(Camera(camera.K, pose, camera.width, camera.height) for pose in poses)
