"""Scenes as 3D Gaussian Splatting .ply files, which public viewers open."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from orca.atomic import atomic_path
from orca.conventions import Float32Array
from orca.errors import BadInput

if TYPE_CHECKING:
    from orca.scene import Scene

__all__ = ["PLY_FIELDS", "SH_C0", "export_ply", "read_ply", "splat_opacities"]

SH_C0 = 0.28209479177387814  # the constant spherical harmonic; f_dc is the colour over it, less one half
PLY_FIELDS = (
    *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"),
    *("scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
)
_ALPHA_LIMITS = (1e-4, 1 - 1e-4)
_TYPES = {"float": "<f4", "float32": "<f4", "double": "<f8", "float64": "<f8", "uchar": "u1", "uint8": "u1"}
_TYPES |= {"int": "<i4", "int32": "<i4", "uint": "<u4", "uint32": "<u4", "short": "<i2", "ushort": "<u2", "char": "i1"}


def splat_opacities(scene: Scene) -> Float32Array:
    """Opacity in [0, 1] of each anchor alone at its centre, 1 - exp(-sigma sigmoid(omega)), [N].

    That is what the quadrature composes (METHOD.md 1). sigmoid(omega) itself, before the decoded density sigma, is not
    an opacity that a splat viewer could use: the scene would be see-through in it.
    """
    import torch

    with torch.inference_mode():
        sigma = scene.decoders(scene.anchors.features)[0]
        alpha = 1.0 - torch.exp(-sigma * torch.sigmoid(scene.anchors.opacity_logits))
    return np.asarray(alpha.cpu().numpy(), np.float32)


def export_ply(scene: Scene, path: str | os.PathLike[str]) -> int:
    """Write the anchors as Gaussian splats (Kerbl et al. 2023 layout, degree 0, binary little endian), atomically.

    Scales are logarithms of standard deviations, opacities logits of `splat_opacities`, rotations wxyz of unit
    length, colours those of each anchor decoded alone. Axes are the scene's: x right, y down, z forward. A splat
    viewer blends anchors one by one where ORCA decodes them together, so the picture is close, not equal.

    Returns:
        How many splats were written.

    Raises:
        BadInput: a path that cannot be written, or a scene with values that are not finite.
    """
    vertices = _vertices(scene)
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    header += [f"property float {name}" for name in PLY_FIELDS] + ["end_header", ""]
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        file.write("\n".join(header).encode("ascii"))
        file.write(vertices.tobytes())
    return len(vertices)


def _vertices(scene: Scene) -> Float32Array:
    """One row per anchor, columns as `PLY_FIELDS`, [N, 17] little endian."""
    anchors = scene.anchors
    means, log_variances = anchors.means.detach().cpu().numpy(), anchors.log_variances.detach().cpu().numpy()
    quaternions = anchors.quaternions.detach().cpu().numpy()
    norms = np.linalg.norm(quaternions, axis=1, keepdims=True)
    colours = np.asarray(scene.anchor_colors(), np.float32)
    alpha = np.clip(splat_opacities(scene).astype(np.float64), *_ALPHA_LIMITS)
    with np.errstate(invalid="ignore", divide="ignore"):
        columns = [
            means,
            np.zeros_like(means),
            (colours - 0.5) / SH_C0,
            np.log(alpha / (1.0 - alpha))[:, None],
            0.5 * log_variances,
            quaternions / norms,
        ]
    table = np.concatenate(columns, axis=1).astype("<f4")
    bad = int((~np.isfinite(table)).any(axis=1).sum())
    if bad:
        raise BadInput(
            f"a scene with {bad} of {len(table)} anchors that are not finite",
            "finite anchors",
            "reconstruct the scene again",
        )
    return table


def read_ply(path: str | os.PathLike[str]) -> NDArray[np.void]:
    """Read the vertices of a binary little-endian .ply as a structured array, one field per property.

    Raises:
        BadInput: no such file, not a .ply of that kind, list properties, or fewer bytes than the header promises.
    """
    source = Path(path)
    try:
        content = source.read_bytes()
    except OSError as error:
        raise BadInput(f"'{source}' cannot be read ({error.strerror})", "a .ply file", "check the path") from error
    head, mark, body = content.partition(b"end_header\n")
    lines = head.decode("ascii", errors="replace").splitlines()
    if not mark or lines[:2] != ["ply", "format binary_little_endian 1.0"]:
        raise BadInput(f"'{source}' is no binary .ply", "format binary_little_endian 1.0", "export it again")
    count, dtype = _layout(lines[2:], source)
    if len(body) < count * dtype.itemsize:
        have = len(body) // max(1, dtype.itemsize)
        raise BadInput(f"'{source}' ends after {have} of {count} vertices", "a complete file", "export it again")
    return np.frombuffer(body, dtype, count)


def _layout(lines: list[str], source: Path) -> tuple[int, np.dtype[np.void]]:
    """Vertex count and record type of the header's first element, which must be the vertices."""
    count: int | None = None
    fields: list[tuple[str, str]] = []
    for words in (line.split() for line in lines):
        if words[:1] == ["element"]:
            if count is not None:
                break  # what follows the vertices is not read
            if len(words) != 3 or words[1] != "vertex" or not words[2].isdecimal():
                count = None
                break
            count = int(words[2])
        elif words[:1] == ["property"] and count is not None:
            if len(words) != 3 or words[1] not in _TYPES:
                raise BadInput(f"'{source}': property '{' '.join(words[1:])}'", "plain numbers", "export it again")
            fields.append((words[2], _TYPES[words[1]]))
    if count is None or not fields:
        raise BadInput(f"'{source}' has no vertices", "an element 'vertex' first in the header", "export it again")
    return count, np.dtype(fields)
