"""A scene case: one input image, what is known about its geometry, and the cameras it is judged along."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from bench.trajectories.trajectory import Trajectory
from orca.camera import Camera
from orca.conventions import Float32Array, UInt8Array

__all__ = ["Dataset", "SceneCase", "TrueView"]


@dataclass(frozen=True, eq=False)
class TrueView:
    """The true look of the scene from another place: a photograph, or an exact rendering of a synthetic scene.

    Attributes:
        camera: where it was taken, in the units of the case.
        image: [H, W, 3] uint8.
        hidden: [H, W] bool, pixels that no input pixel reaches (BENCH.md, `hole_psnr`).
        depth: true z-depth in the units of the case, [H, W] float32; None where nobody knows it.
        occluder_depth: z-depth, in this view, of what hid a hidden pixel's point from the input; NaN where there is
            none or it is the same object, [H, W] float32; None where nobody knows it.
    """

    camera: Camera
    image: UInt8Array
    hidden: NDArray[np.bool_]
    depth: Float32Array | None = None
    occluder_depth: Float32Array | None = None


@dataclass(frozen=True, eq=False)
class SceneCase:
    """One scene of a data set.

    Attributes:
        dataset: name of the data set.
        name: name of the scene, also its file name in a run.
        image: the input, [H, W, 3] uint8.
        camera: the input camera (identity pose), same size as ``image``.
        depth: reference z-depth of the input, [H, W] float32, positive, in trajectory units (scene radii R).
        depth_source: where the depth comes from, in words a table can print ("Depth Pro via VistaDream", "heuristic").
        depth_is_metric: True if the depth is proportional to true depth; False for a guess such as the heuristic.
        depth_is_measured: True if it was measured (stereo, a scanner) and not estimated: its edges are to be trusted.
        fov_source: where the field of view comes from.
        trajectory: the full path.
        eval_indices: frames of the path that are rendered and scored.
        true_views: real photographs from other places; empty for most scenes.
    """

    dataset: str
    name: str
    image: UInt8Array
    camera: Camera
    depth: Float32Array
    depth_source: str
    depth_is_metric: bool
    fov_source: str
    trajectory: Trajectory
    eval_indices: tuple[int, ...]
    true_views: tuple[TrueView, ...] = ()
    depth_is_measured: bool = False

    @property
    def eval_trajectory(self) -> Trajectory:
        """The evaluated frames as a trajectory of their own."""
        return self.trajectory.subset(self.eval_indices)


class Dataset(Protocol):
    """A named collection of scene cases, loaded one at a time."""

    name: str

    def scenes(self) -> Sequence[str]:
        """Scene names in their fixed order. Raises `Unavailable` when the data are not here."""
        ...

    def load(self, scene: str) -> SceneCase:
        """Read one scene. Raises `Unknown` for a wrong name, `BadInput` for a broken file."""
        ...
