"""Renders other methods' splats along our cameras: colour, coverage and depth of a view.

The renderer is `orca.splats.view`; here a method's unit of length and its axes are brought to the case's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bench.adapters.splat_cloud import SplatCloud
from orca.camera import Camera
from orca.conventions import Float32Array, Float64Array
from orca.errors import BadInput
from orca.splats.model import Splats
from orca.splats.view import SplatView, view_splats

__all__ = ["Placement", "place", "render_cloud"]

_COVERED = 0.5  # a pixel with less alpha says nothing about depth


@dataclass(frozen=True)
class Placement:
    """How a method's unit of length compares with the case's (BENCH.md: the median ratio of input-view depths).

    Attributes:
        scale: method units per scene radius.
        spread: p84 / p16 of the ratio; 1 for the same geometry in another unit.
    """

    scale: float
    spread: float


def place(cloud: SplatCloud, camera: Camera, depth: Float32Array) -> tuple[SplatCloud, Placement]:
    """The cloud in the units of the reference depth, by the median ratio of depths seen from the input view.

    Args:
        cloud: splats in their own unit.
        camera: the input camera of the case.
        depth: reference z-depth, [H, W].

    Raises:
        BadInput: the input view shows hardly any splat, so there is no ratio.
    """
    pose = cloud.input_pose
    z = cloud.means.astype(np.float64) @ pose[2, :3] + pose[2, 3]
    in_front = z[z > 0]
    if in_front.size == 0:
        raise BadInput("splats that all lie behind the input camera", "z forward, as in OpenCV", "check the axes")
    # First to a size at which the near plane means what it should.
    unit = float(np.median(in_front))
    rendered = render_cloud(cloud.scaled(1.0 / unit), camera)
    seen = (rendered.alpha > _COVERED) & (rendered.depth > 0)
    if seen.mean() < 0.01:
        raise BadInput(
            f"splats that cover {100 * seen.mean():.1f} % of the input view",
            "1 % or more, or their scale cannot be told",
            "check the axes and the input camera (OpenCV, world = input view, or a camera file beside the splats)",
        )
    ratio = unit * rendered.depth[seen].astype(np.float64) / depth[seen]
    low, middle, high = (float(q) for q in np.percentile(ratio, (16, 50, 84)))
    return cloud.scaled(1.0 / middle), Placement(middle, high / low)


def render_cloud(cloud: SplatCloud, camera: Camera) -> SplatView:
    """Render one view; the camera's pose is relative to the input view, its translation in the cloud's unit."""
    own = replace(camera, world_to_camera=camera.world_to_camera @ cloud.input_pose)
    return view_splats(_splats(cloud, own.center), own)


def _splats(cloud: SplatCloud, centre: Float64Array) -> Splats:
    norms = np.linalg.norm(cloud.quaternions, axis=1, keepdims=True)
    return Splats(
        means=cloud.means,
        log_scales=cloud.log_scales,
        quaternions=(cloud.quaternions / norms).astype(np.float32),
        colours=cloud.colours(centre),
        opacities=cloud.opacities(),
        stage=np.zeros(len(cloud), np.uint8),
    )
