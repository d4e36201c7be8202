"""Scenes as 3D Gaussian Splatting .ply files, which public viewers open."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from orca.atomic import atomic_path
from orca.conventions import Float32Array
from orca.errors import BadInput
from orca.splats.bake import anchor_splats, splat_opacities
from orca.splats.model import Splats

if TYPE_CHECKING:
    from orca.scene import Scene

__all__ = ["PLY_FIELDS", "SH_C0", "export_ply", "read_ply", "read_splats", "splat_opacities", "write_splats"]

SH_C0 = 0.28209479177387814  # the constant spherical harmonic; f_dc is the colour over it, less one half
PLY_FIELDS = (
    *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"),
    *("scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
)
MAX_BYTES = 8 * 2**30  # of a file that is read
_ALPHA_LIMITS = (1e-4, 1 - 1e-4)
_TYPES = {"float": "<f4", "float32": "<f4", "double": "<f8", "float64": "<f8", "uchar": "u1", "uint8": "u1"}
_TYPES |= {"int": "<i4", "int32": "<i4", "uint": "<u4", "uint32": "<u4", "short": "<i2", "ushort": "<u2", "char": "i1"}


def export_ply(scene: Scene, path: str | os.PathLike[str]) -> int:
    """Write each anchor as the splat that it is alone, without fitting (see `orca.splats.bake` for that).

    Returns:
        How many splats were written.

    Raises:
        BadInput: a path that cannot be written, or a scene with values that are not finite.
    """
    return write_splats(anchor_splats(scene), path)


def write_splats(splats: Splats, path: str | os.PathLike[str]) -> int:
    """Write splats as .ply (Kerbl et al. 2023 layout, degree 0, binary little endian), atomically; return how many.

    Scales are logarithms of standard deviations, opacities logits, rotations wxyz of unit length. Axes are the
    scene's: x right, y down, z forward. The layout has no room for the stage.

    Raises:
        BadInput: a path that cannot be written, or values that are not finite.
    """
    table = _vertices(splats)
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(table)}"]
    header += [f"property float {name}" for name in PLY_FIELDS] + ["end_header", ""]
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        file.write("\n".join(header).encode("ascii"))
        file.write(table.tobytes())
    return len(table)


def _vertices(splats: Splats) -> Float32Array:
    """One row per splat, columns as `PLY_FIELDS`, [N, 17] little endian."""
    if bad := splats.broken():
        raise BadInput(f"{bad} of {len(splats)} splats that are not finite", "finite splats", "bake the scene again")
    alpha = np.clip(splats.opacities.astype(np.float64), *_ALPHA_LIMITS)
    columns = [
        splats.means,
        np.zeros_like(splats.means),
        (splats.colours - 0.5) / SH_C0,
        np.log(alpha / (1.0 - alpha))[:, None],
        splats.log_scales,
        splats.quaternions,
    ]
    return np.concatenate(columns, axis=1).astype("<f4")


def read_splats(path: str | os.PathLike[str]) -> Splats:
    """Read a .ply of degree 0 back as splats, all of the original stage (`orca.splats.split.stages` finds others).

    Args:
        path: a file that `write_splats` wrote, or another of that layout (higher harmonics are not read).

    Raises:
        BadInput: no such file, not such a file, or values that are not finite.
    """
    table = read_ply(path)
    missing = [name for name in PLY_FIELDS if name not in (*(table.dtype.names or ()), "nx", "ny", "nz")]
    if missing:
        raise BadInput(f"'{path}' without {', '.join(missing)}", "a 3D Gaussian splat .ply", "export it again")

    def columns(*names: str) -> Float32Array:
        return np.stack([table[name] for name in names], axis=1).astype(np.float32)

    splats = Splats(
        means=columns("x", "y", "z"),
        log_scales=columns("scale_0", "scale_1", "scale_2"),
        quaternions=columns("rot_0", "rot_1", "rot_2", "rot_3"),
        colours=columns("f_dc_0", "f_dc_1", "f_dc_2") * np.float32(SH_C0) + np.float32(0.5),
        opacities=np.asarray(1 / (1 + np.exp(-columns("opacity")[:, 0])), np.float32),
        stage=np.zeros(len(table), np.uint8),
    )
    if bad := splats.broken():
        raise BadInput(f"'{path}' with {bad} splats that are not finite", "finite values", "export it again")
    return splats


def read_ply(path: str | os.PathLike[str]) -> NDArray[np.void]:
    """Read the vertices of a binary little-endian .ply as a structured array, one field per property.

    Raises:
        BadInput: no such file, not a .ply of that kind, list properties, or fewer bytes than the header promises.
    """
    source = Path(path)
    try:
        if source.stat().st_size > MAX_BYTES:
            raise BadInput(f"'{source}' of {source.stat().st_size} bytes", f"at most {MAX_BYTES}", "thin the scene out")
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
            if len(words) != 3 or words[1] != "vertex" or not re.fullmatch(r"[0-9]{1,18}", words[2]):
                count = None
                break
            count = int(words[2])
        elif words[:1] == ["property"] and count is not None:
            if len(words) != 3 or words[1] not in _TYPES:
                raise BadInput(f"'{source}': property '{' '.join(words[1:])}'", "plain numbers", "export it again")
            fields.append((words[2], _TYPES[words[1]]))
    if count is None or not fields:
        raise BadInput(f"'{source}' has no vertices", "an element 'vertex' first in the header", "export it again")
    if len({name for name, _ in fields}) != len(fields):
        raise BadInput(f"'{source}' has two properties of one name", "a name for each", "export it again")
    return count, np.dtype(fields)
