"""Stage 2: move every anchor along its own viewing ray to the depth of the scene (paper Sec. 3.2).

The paper's z axis points from the plane to the camera. With the camera at the origin of OpenCV axes, z_paper = -z, so
c_z = 0 and gamma = (c_z - z~_paper) / (c_z - mu_paper) = z~ / mu_z: the ratio of the new z-depth to the old one. The
signs are derived here and nowhere else (a test checks them against the paper's formulas written out).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from orca.anchors import GaussianAnchors, rotations_to_quaternions
from orca.camera import Camera
from orca.config import DeformConfig
from orca.conventions import Float32Array, Float64Array
from orca.errors import BadInput

__all__ = [
    "RelativeTarget",
    "cleaned_depth",
    "deform",
    "denoise_depth",
    "log_depth_slopes",
    "metric_target",
    "sample_depth",
    "sharpen_depth",
]


def deform(anchors: GaussianAnchors, depth: Float32Array, camera: Camera, config: DeformConfig) -> GaussianAnchors:
    """Anchors at the depth of the scene, each on its own ray, with extents that keep the input view's footprints.

    The paper finds each anchor's place in the depth map by normalising x and y with the cloud's extent; the canvas
    camera's projection is the same map without its half-cell error (O).

    Args:
        anchors: anchors on a plane parallel to the image, in camera coordinates (identity pose).
        depth: z-depth over the canvas, [H, W], positive; see `cleaned_depth`.
        camera: the canvas camera (identity pose), same size as ``depth``.
        config: lifting, quantiles, edge handling.

    Raises:
        BadInput: the depth is not finite and positive everywhere.
    """
    _check_positive(depth)
    means = anchors.means.double().numpy()
    pixels, _ = camera.project(means)
    sampled = sample_depth(depth, pixels)
    target = metric_target if config.lifting == "metric" else RelativeTarget.fit(means, sampled, config)
    gamma = target(sampled) / means[:, 2]
    slopes = np.zeros((len(means), 2))
    if config.follow_slope:
        slopes = log_depth_slopes(target(depth), pixels, camera, config.max_slope)
    log_variances, quaternions = _push_forward(anchors, torch.from_numpy(gamma), torch.from_numpy(slopes))
    moved = torch.from_numpy((means * gamma[:, None]).astype(np.float32))
    return replace(anchors, means=moved, log_variances=log_variances, quaternions=quaternions)


def metric_target(depth: NDArray[Any]) -> Float64Array:
    """Metric lifting: the target depth is the provider's depth."""
    return np.asarray(depth, np.float64)


@dataclass(frozen=True)
class RelativeTarget:
    """The paper's lifting, in OpenCV's sign: z~ = z_base - lambda L_xy s (paper Eq. 2 to 5).

    Attributes:
        q_far, q_near: robust quantiles of inverse depth over the anchors.
        base: median z of the plane.
        reach: lambda times the largest extent of the cloud in x and y.
        epsilon: guard of the inverse depth.
    """

    q_far: float
    q_near: float
    base: float
    reach: float
    epsilon: float

    @staticmethod
    def fit(means: Float64Array, depth: Float64Array, config: DeformConfig) -> RelativeTarget:
        """The target of a cloud [N, 3] with the depth [N] sampled at its anchors."""
        q = 1 / np.maximum(depth, config.epsilon)
        far, near = np.quantile(q, [config.far_quantile, config.near_quantile])
        extent = float(np.ptp(means[:, :2], axis=0).max())
        return RelativeTarget(
            float(far), float(near), float(np.median(means[:, 2])), config.strength * extent, config.epsilon
        )

    def nearness(self, depth: NDArray[Any]) -> Float64Array:
        """s in [0, 1]: 1 at the near quantile, 0 at the far one and for constant depth."""
        span = self.q_near - self.q_far
        if span <= 1e-9 * abs(self.q_near):
            return np.zeros(np.shape(depth))
        q = 1 / np.maximum(np.asarray(depth, np.float64), self.epsilon)
        return np.clip((q - self.q_far) / span, 0, 1)

    def __call__(self, depth: NDArray[Any]) -> Float64Array:
        """Target z-depth of provider depths, any shape."""
        target = self.base - self.reach * self.nearness(depth)
        # A strength that pushes the nearest point through the camera has no meaning: stop at a tenth of the distance.
        return np.asarray(np.maximum(target, 0.1 * self.base))


def sample_depth(depth: Float32Array, pixels: Float64Array) -> Float64Array:
    """Depth [N] at pixel positions [N, 2], bilinear, the border repeated."""
    x = np.clip(pixels[:, 0] - 0.5, 0, depth.shape[1] - 1)
    y = np.clip(pixels[:, 1] - 0.5, 0, depth.shape[0] - 1)
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    x1, y1 = np.minimum(x0 + 1, depth.shape[1] - 1), np.minimum(y0 + 1, depth.shape[0] - 1)
    fx, fy = x - x0, y - y0
    corners = np.stack([depth[y0, x0], depth[y0, x1], depth[y1, x0], depth[y1, x1]]).astype(np.float64)
    weights = np.stack([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy])
    blended = (corners * weights).sum(0)
    # Across a depth edge a bilinear mean belongs to neither surface: take the nearest sample there.
    nearest = corners[weights.argmax(0), np.arange(len(x))]
    torn = corners.max(0) > 1.05 * corners.min(0)
    return np.asarray(np.where(torn, nearest, blended))


def cleaned_depth(depth: Float32Array, config: DeformConfig) -> Float32Array:
    """The depth that anchors are lifted to: denoised and sharpened as configured.

    Raises `BadInput` for a depth that is not finite and positive everywhere.
    """
    _check_positive(depth)
    if config.denoise_depth:
        depth = denoise_depth(depth)
    return sharpen_depth(depth, config.edge_ratio) if config.sharpen_depth else depth


def _check_positive(depth: Float32Array) -> None:
    if not np.isfinite(depth).all() or (depth <= 0).any():
        bad = int((~np.isfinite(depth) | (depth <= 0)).sum())
        raise BadInput(
            f"depth with {bad} of {depth.size} values that are not finite and positive",
            "finite z-depth > 0 everywhere",
            "repair the depth map or choose another provider",
        )


def denoise_depth(depth: Float32Array) -> Float32Array:
    """Depth without speckle: a median, then a bilateral filter in log depth, which leaves real edges standing.

    A depth map that went through a video codec or a small network carries steps of a few percent on near surfaces;
    taken at face value they tear the surface apart.
    """
    log = cv2.medianBlur(cv2.medianBlur(np.log(depth), 5), 5)
    return np.asarray(np.exp(cv2.bilateralFilter(log, 9, 0.08, 4.0)), np.float32)


def sharpen_depth(depth: Float32Array, edge_ratio: float, radius: int = 3) -> Float32Array:
    """Give every pixel of a soft depth edge to the nearer (in log depth) of the two surfaces it lies between.

    A pixel counts as soft where the depth range in its window exceeds ``edge_ratio`` and most of that range is
    crossed within the window, as at an edge, not as on a slope. The ends of a ramp as wide as the window do not see
    both its levels; once its middle is sharp they do, and what then lies off both by half the ratio is moved too.
    """
    log = np.log(depth)
    sharp = _snapped(log, edge_ratio, radius, 0.0)
    sharp = _snapped(sharp, edge_ratio, radius, 0.5 * float(np.log(edge_ratio)))
    return np.asarray(np.where(sharp == log, depth, np.exp(sharp)), np.float32)


def _snapped(log: Float32Array, edge_ratio: float, radius: int, off: float) -> Float32Array:
    """One pass of `sharpen_depth` over log depth, on pixels at least ``off`` from the two levels around them."""
    kernel = np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)
    low, high = cv2.erode(log, kernel), cv2.dilate(log, kernel)
    wide = np.ones((4 * radius + 1, 4 * radius + 1), np.uint8)
    range_here, range_wide = high - low, cv2.dilate(log, wide) - cv2.erode(log, wide)
    # On a slope the range doubles with the window; at an edge it stays.
    edge = (range_here > np.log(edge_ratio)) & (range_here > 0.75 * range_wide)
    edge &= (log - low >= off) & (high - log >= off)
    return np.asarray(np.where(edge, np.where(log - low < high - log, low, high), log), np.float32)


def log_depth_slopes(depth: NDArray[Any], pixels: Float64Array, camera: Camera, max_slope: float) -> Float64Array:
    """d log z / d(tangent) at each anchor, [N, 2], in units of the normalised image plane; zero at depth edges."""
    # Beyond the border the depth goes on as it came, so that a slope has the same slope there.
    padded = np.pad(np.log(depth), 5, mode="reflect", reflect_type="odd")
    log = np.asarray(cv2.GaussianBlur(padded, (0, 0), 1.0))[4:-4, 4:-4]
    column = np.clip(pixels[:, 0].astype(int), 0, depth.shape[1] - 1) + 1
    row = np.clip(pixels[:, 1].astype(int), 0, depth.shape[0] - 1) + 1
    here = log[row, column]
    along_x = _smaller(here - log[row, column - 1], log[row, column + 1] - here) * camera.K[0, 0]
    along_y = _smaller(here - log[row - 1, column], log[row + 1, column] - here) * camera.K[1, 1]
    slope = np.stack([along_x, along_y], 1)
    steep = np.linalg.norm(slope, axis=1, keepdims=True) > max_slope
    return np.where(steep, 0.0, slope)


def _smaller(backward: Float64Array, forward: Float64Array) -> Float64Array:
    """The smaller of two one-sided differences: at an edge it looks along the surface and not across the step."""
    return np.where(np.abs(forward) < np.abs(backward), forward, backward)


def _push_forward(anchors: GaussianAnchors, gamma: Tensor, slopes: Tensor) -> tuple[Tensor, Tensor]:
    """Covariances carried from the plane to the surface: in the plane by mu -> gamma mu, to first order.

    With u = mu / mu_z, a step e_k in the plane becomes gamma (e_k + u slope_k), which is tangent to the surface and
    leaves the footprint in the input view as it is. A step e_z becomes the part of gamma u along the surface's normal:
    the Gaussian lies flat, det J = gamma^3, and a floor or a side wall seen edge-on keeps a thickness. With zero slope
    this adds 2 log gamma to each log-variance: a Gaussian twice as near is half as wide.
    """
    flat = slopes.abs().sum(1) == 0
    scaled = anchors.log_variances + 2 * torch.log(gamma).float()[:, None]
    if bool(flat.all()):
        return scaled, anchors.quaternions
    tilted = ~flat
    direction = anchors.means[tilted].double() / anchors.means[tilted, 2:3].double()
    steps = torch.eye(3, dtype=torch.float64)[:2] + slopes[tilted][:, :, None] * direction[:, None, :]
    normal = torch.nn.functional.normalize(torch.linalg.cross(steps[:, 0], steps[:, 1]), dim=-1)
    through = (normal * direction).sum(-1, keepdim=True) * normal
    J = gamma[tilted][:, None, None] * torch.stack([steps[:, 0], steps[:, 1], through], -1)
    covariance = J @ anchors.covariances()[tilted].double() @ J.transpose(1, 2)
    variances, axes = torch.linalg.eigh(covariance)
    axes = axes * torch.sign(torch.linalg.det(axes))[:, None, None]
    log_variances, quaternions = scaled.clone(), anchors.quaternions.clone()
    log_variances[tilted] = torch.log(variances.clamp_min(1e-20)).float()
    quaternions[tilted] = rotations_to_quaternions(axes).float()
    return log_variances, quaternions
