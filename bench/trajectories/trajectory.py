"""A trajectory is data: cameras, a unit, a name, and one SHA-256 over all of it. It belongs to the data set."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from orca.camera import Camera
from orca.conventions import Float64Array
from orca.errors import BadInput

__all__ = ["Trajectory"]


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A named camera path.

    Attributes:
        name: which path this is ("vistadream", "spiral", ...).
        K: intrinsics per frame, [F, 3, 3] float64, pixels.
        world_to_camera: poses per frame, [F, 4, 4] float64, OpenCV axes; the input camera is the identity.
        width: image width in pixels.
        height: image height in pixels.
        unit: the length that 1.0 stands for ("R": the scene radius; see BENCH of the design notes).
        fps: frames a second, for videos.
    """

    name: str
    K: Float64Array
    world_to_camera: Float64Array
    width: int
    height: int
    unit: str = "R"
    fps: float = 20.0

    def __post_init__(self) -> None:
        K, poses = np.array(self.K, np.float64), np.array(self.world_to_camera, np.float64)
        if poses.ndim != 3 or poses.shape[1:] != (4, 4) or len(poses) == 0:
            raise BadInput(
                f"poses of shape {poses.shape}", "world_to_camera [F, 4, 4] with F >= 1", "check the camera file"
            )
        if K.shape == (3, 3):
            K = np.broadcast_to(K, (len(poses), 3, 3)).copy()
        if K.shape != (len(poses), 3, 3) or not (np.isfinite(K).all() and np.isfinite(poses).all()):
            raise BadInput(
                f"intrinsics of shape {K.shape} for {len(poses)} poses, finite: {bool(np.isfinite(K).all())}",
                "finite K [3, 3] or [F, 3, 3]",
                "check the camera file",
            )
        K.setflags(write=False)
        poses.setflags(write=False)
        object.__setattr__(self, "K", K)
        object.__setattr__(self, "world_to_camera", poses)

    def __len__(self) -> int:
        return len(self.world_to_camera)

    def camera(self, index: int) -> Camera:
        """The camera of one frame."""
        return Camera(self.K[index], self.world_to_camera[index], self.width, self.height)

    def cameras(self) -> tuple[Camera, ...]:
        """All cameras, in order."""
        return tuple(self.camera(i) for i in range(len(self)))

    def subset(self, indices: Sequence[int]) -> Trajectory:
        """The frames at ``indices`` only (another trajectory, with another hash)."""
        rows = list(indices)
        return replace(self, K=self.K[rows], world_to_camera=self.world_to_camera[rows])

    @cached_property
    def sha256(self) -> str:
        """Hash of everything that fixes the views. Poses are rounded to 1e-9 first, so that it survives a text file."""
        head = {"name": self.name, "width": self.width, "height": self.height, "unit": self.unit, "frames": len(self)}
        digest = hashlib.sha256(json.dumps(head, sort_keys=True).encode())
        for array in (self.K, self.world_to_camera):
            digest.update((np.round(array, 9) + 0.0).astype("<f8").tobytes())
        return digest.hexdigest()

    def to_json(self) -> dict[str, Any]:
        """Plain data, readable by `from_json`."""
        return {
            "schema_version": 1,
            "name": self.name,
            "width": self.width,
            "height": self.height,
            "unit": self.unit,
            "fps": self.fps,
            "K": self.K.tolist(),
            "world_to_camera": self.world_to_camera.tolist(),
        }

    @staticmethod
    def from_json(document: dict[str, Any]) -> Trajectory:
        """Read what `to_json` wrote; raises `BadInput` when a field is missing."""
        try:
            return Trajectory(
                name=str(document["name"]),
                K=np.asarray(document["K"], np.float64),
                world_to_camera=np.asarray(document["world_to_camera"], np.float64),
                width=int(document["width"]),
                height=int(document["height"]),
                unit=str(document.get("unit", "R")),
                fps=float(document.get("fps", 20.0)),
            )
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            if isinstance(error, BadInput):
                raise
            raise BadInput(
                f"a camera file with a missing or broken field ({error})",
                "name, K, world_to_camera, width, height",
                "write the file with Trajectory.to_json",
            ) from error
