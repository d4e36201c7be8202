"""Reads a scene that VistaDream saved with ``torch.save``: a pickle of its classes, of which none is imported.

``Gaussian_Scene.gaussian_frames`` hold the splats of one RGB-D frame each: ``rgb`` (sigmoid), ``scale`` (exp),
``opacity`` (sigmoid), ``rotation`` (wxyz), ``xyz``; no spherical harmonics. ``frames`` hold the cameras
(``extrinsic``: OpenCV world-to-camera, frame 0 the input view and the identity).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.adapters.restricted_pickle import Inert, PickledArray
from bench.adapters.splat_cloud import SH_C0, SplatCloud
from bench.adapters.torch_file import read_torch_file
from orca.conventions import Float32Array
from orca.errors import BadInput

__all__ = ["read_vistadream_scene"]


class _Scene(Inert):
    pass


class _GaussianFrame(Inert):
    pass


class _Frame(Inert):
    pass


_CLASSES = {"Gaussian_Scene": _Scene, "Gaussian_Frame": _GaussianFrame, "Frame": _Frame}
_MODULES = ("ops.gs.basic", "ops.gs", "ops.gs.train")  # where the published code defines and re-exports them
_ALLOWED = {(module, name): kind for module in _MODULES for name, kind in _CLASSES.items()}
_WHAT = "a scene.pth of VistaDream: Gaussian_Scene with frames and gaussian_frames"


def read_vistadream_scene(path: Path) -> SplatCloud:
    """The splats of all frames in the world of the input view, in VistaDream's unit of length.

    Splats with infinite values, which its files contain, are left out and counted.

    Raises:
        BadInput: anything but such a file; what a refused pickle contains is named.
    """
    scene = read_torch_file(path, _ALLOWED)
    if not isinstance(scene, _Scene):
        raise BadInput(f"{path} holds a {type(scene).__name__.strip('_')}", _WHAT, "name the scene's file")
    frames = scene.fields.get("gaussian_frames")
    if not isinstance(frames, list) or not frames or not all(isinstance(f, _GaussianFrame) for f in frames):
        raise BadInput(f"{path} without gaussian_frames", _WHAT, "name the scene's file")
    columns = {"xyz": 3, "scale": 3, "rotation": 4, "opacity": 1, "rgb": 3}
    parts = {name: _joined(path, frames, name, width) for name, width in columns.items()}
    counts = {len(part) for part in parts.values()}
    if len(counts) != 1:
        raise BadInput(
            f"{path} with splats of {sorted(counts)} rows", "one row a splat in every field", "save it again"
        )
    with np.errstate(over="ignore"):
        rgb = 1.0 / (1.0 + np.exp(-parts["rgb"].astype(np.float64)))
    cloud = SplatCloud(
        means=parts["xyz"],
        log_scales=parts["scale"],
        quaternions=parts["rotation"],
        opacity_logits=parts["opacity"][:, 0],
        sh=((rgb - 0.5) / SH_C0).astype(np.float32)[:, None, :],
    ).usable()
    return cloud.seen_from(_input_pose(path, scene.fields.get("frames")))


def _joined(path: Path, frames: Sequence[_GaussianFrame], name: str, width: int) -> Float32Array:
    """One field of all frames, [N, width] float32."""
    parts = []
    for index, frame in enumerate(frames):
        values = _array(frame.fields.get(name))
        if values is None or values.size % width or values.dtype.kind not in "fiu":
            raise BadInput(f"{path}: frame {index} has no {name} of {width} numbers a splat", _WHAT, "save it again")
        parts.append(values.reshape(-1, width).astype(np.float32))
    return np.concatenate(parts)


def _array(value: Any) -> NDArray[Any] | None:
    if isinstance(value, PickledArray):
        return value.value
    return value if isinstance(value, np.ndarray) else None


def _input_pose(path: Path, frames: object) -> NDArray[np.float64]:
    """World-to-camera of frame 0, [4, 4]; the identity where the scene keeps no frames."""
    if not isinstance(frames, list) or not frames or not isinstance(frames[0], _Frame):
        return np.eye(4)
    pose = _array(frames[0].fields.get("extrinsic"))
    if pose is None or pose.shape != (4, 4) or not np.isfinite(pose.astype(np.float64)).all():
        raise BadInput(f"{path}: frame 0 has no extrinsic [4, 4]", _WHAT, "save it again")
    return pose.astype(np.float64)
