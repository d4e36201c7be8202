"""The pinhole camera: K, pose and size."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from orca.conventions import Float64Array, pixel_grid
from orca.errors import BadInput

__all__ = ["Camera"]

_RIGID = 1e-3  # largest deviation of R R^T from the identity


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera with OpenCV axes.

    Attributes:
        K: intrinsics in pixels, [3, 3] float64, pixel centres at +0.5.
        world_to_camera: rigid pose, [4, 4] float64; a rotation may be off by 1e-3, as in files of few digits.
        width: image width in pixels.
        height: image height in pixels.
    """

    K: Float64Array
    world_to_camera: Float64Array
    width: int
    height: int

    def __post_init__(self) -> None:
        K = np.array(self.K, np.float64)
        pose = np.array(self.world_to_camera, np.float64)
        if K.shape != (3, 3) or pose.shape != (4, 4) or not (np.isfinite(K).all() and np.isfinite(pose).all()):
            raise BadInput(
                f"camera with K of shape {K.shape} and pose of shape {pose.shape}",
                "finite K [3, 3] and world_to_camera [4, 4]",
                "check the camera file",
            )
        if self.width < 1 or self.height < 1 or K[0, 0] <= 0 or K[1, 1] <= 0:
            raise BadInput(
                f"camera of {self.width}x{self.height} pixels with focal lengths {K[0, 0]:g}, {K[1, 1]:g}",
                "a positive size and positive focal lengths",
                "check the camera file",
            )
        _check_rigid(pose)
        K.setflags(write=False)
        pose.setflags(write=False)
        object.__setattr__(self, "K", K)
        object.__setattr__(self, "world_to_camera", pose)

    @staticmethod
    def from_fov(width: int, height: int, hfov_deg: float, world_to_camera: ArrayLike | None = None) -> Camera:
        """Camera with square pixels, principal point at the image centre and a horizontal field of view in degrees."""
        if not 1.0 <= hfov_deg <= 170.0:
            raise BadInput(f"field of view {hfov_deg:g} degrees", "1 to 170 degrees", "give another field of view")
        f = 0.5 * width / math.tan(math.radians(hfov_deg) / 2)
        K = np.array([[f, 0, width / 2], [0, f, height / 2], [0, 0, 1]])
        pose = np.eye(4) if world_to_camera is None else np.asarray(world_to_camera, np.float64)
        return Camera(K, pose, width, height)

    @property
    def hfov_deg(self) -> float:
        """Horizontal field of view in degrees."""
        f, cx = self.K[0, 0], self.K[0, 2]
        return math.degrees(math.atan2(cx, f) + math.atan2(self.width - cx, f))

    @property
    def rotation(self) -> Float64Array:
        """World-to-camera rotation, [3, 3]."""
        return self.world_to_camera[:3, :3]

    @property
    def translation(self) -> Float64Array:
        """World-to-camera translation, [3]."""
        return self.world_to_camera[:3, 3]

    @property
    def center(self) -> Float64Array:
        """Camera centre in world coordinates, [3]."""
        return np.asarray(-self.rotation.T @ self.translation)

    def pixel_to_ray(self) -> Float64Array:
        """M = R^T K^-1, [3, 3]: the world direction of homogeneous pixel (x, y, 1), with camera z equal to 1."""
        return np.asarray(self.rotation.T @ np.linalg.inv(self.K))

    def rays(self, pixels: Float64Array | None = None) -> Float64Array:
        """World ray directions, [n, 3], not normalised: camera-space z is 1, so t along a ray is z-depth.

        Args:
            pixels: (x, y) positions, [n, 2]; all pixel centres, row by row, when left out.
        """
        xy = pixel_grid(self.width, self.height) if pixels is None else np.asarray(pixels, np.float64)
        return np.asarray(np.concatenate([xy, np.ones((len(xy), 1))], axis=1) @ self.pixel_to_ray().T)

    def project(self, points: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Project world points [n, 3] to pixels [n, 2] and z-depths [n]. Pixels mean nothing where depth <= 0."""
        local = np.asarray(points, np.float64) @ self.rotation.T + self.translation
        z = local[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            pixels = (local @ self.K.T)[:, :2] / z[:, None]
        return pixels, z

    def unproject(self, pixels: Float64Array, depth: Float64Array) -> Float64Array:
        """World points [n, 3] at pixels [n, 2] and z-depths [n]."""
        return np.asarray(self.center + self.rays(pixels) * np.asarray(depth, np.float64)[:, None])

    def resized(self, width: int, height: int) -> Camera:
        """The same view at another resolution (half-pixel convention: K scales with the size)."""
        scale = np.diag([width / self.width, height / self.height, 1.0])
        return replace(self, K=scale @ self.K, width=width, height=height)

    def padded(self, left: int, top: int, right: int, bottom: int) -> Camera:
        """The same camera with a larger canvas: margins in pixels on the four sides."""
        K = self.K.copy()
        K[0, 2] += left
        K[1, 2] += top
        return replace(self, K=K, width=self.width + left + right, height=self.height + top + bottom)


def _check_rigid(pose: Float64Array) -> None:
    """A pose that stretches or mirrors the world has no camera centre that the formulas here would find."""
    rotation = pose[:3, :3]
    worst = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if worst > _RIGID or np.linalg.det(rotation) < 0 or np.abs(pose[3] - [0, 0, 0, 1]).max() > _RIGID:
        raise BadInput(
            f"a pose whose rotation R has |R R^T - 1| up to {worst:.3g} and determinant {np.linalg.det(rotation):.3g}, "
            f"last row {pose[3].tolist()}",
            "a rigid world_to_camera: rotation and translation, no scale, no mirroring, last row 0 0 0 1",
            "orthonormalise the rotation; a mirrored pose is in other axes than OpenCV's (x right, y down, z ahead)",
        )
