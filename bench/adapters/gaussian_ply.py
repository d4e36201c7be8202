"""Reads the .ply of 3D Gaussian splatting (Kerbl et al. 2023), degree 0 to 3, of whatever method wrote it."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.adapters.splat_cloud import MAX_SPLATS, SplatCloud
from orca.conventions import Float32Array
from orca.errors import BadInput
from orca.export import read_ply

__all__ = ["read_gaussian_ply"]

MAX_BYTES = 8 * 2**30
_HEADER_BYTES = 64 * 2**10
_REST_OF_DEGREE = {0: 0, 9: 3, 24: 8, 45: 15}


def read_gaussian_ply(path: Path) -> SplatCloud:
    """Read the splats of a binary little-endian .ply.

    Scales are logarithms, opacities logits, rotations wxyz; ``f_rest`` holds the higher harmonics channel by channel.
    A file without harmonics but with ``red, green, blue`` bytes is a point cloud, and refused.

    Raises:
        BadInput: no such file, not a splat file, too large, or damaged.
    """
    _check_header(path)
    table = read_ply(path)
    names = table.dtype.names or ()
    needed = ("x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_3")
    missing = [name for name in needed if name not in names]
    if missing:
        raise BadInput(
            f"{path} without {', '.join(missing)} (it has {', '.join(names)[:100]})",
            "the properties of 3D Gaussian splatting",
            "export splats, not a point cloud or a mesh",
        )
    rest = sum(bool(re.fullmatch(r"f_rest_\d+", name)) for name in names)
    if rest not in _REST_OF_DEGREE:
        raise BadInput(f"{path} with {rest} f_rest properties", "0, 9, 24 or 45 (degree 0 to 3)", "export it again")
    return SplatCloud(
        means=_columns(table, "x", "y", "z"),
        log_scales=_columns(table, "scale_0", "scale_1", "scale_2"),
        quaternions=_columns(table, "rot_0", "rot_1", "rot_2", "rot_3"),
        opacity_logits=_columns(table, "opacity")[:, 0],
        sh=_harmonics(table, _REST_OF_DEGREE[rest]),
    ).usable()


def _check_header(path: Path) -> None:
    """Refuse by size and header before the whole file is read."""
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            head = file.read(_HEADER_BYTES)
    except OSError as error:
        raise BadInput(f"'{path}' cannot be read ({error.strerror})", "a .ply file", "check the path") from error
    if size > MAX_BYTES:
        raise BadInput(f"'{path}' of {size} bytes", f"at most {MAX_BYTES}", "thin the scene out")
    text, mark, _ = head.partition(b"end_header\n")
    if not mark or not text.startswith(b"ply\nformat binary_little_endian 1.0\n"):
        raise BadInput(f"'{path}' is no binary .ply", "format binary_little_endian 1.0", "export it again")
    count = re.search(rb"^element vertex (\d{1,18})$", text, re.MULTILINE)
    if count is None or int(count[1]) > MAX_SPLATS:
        raise BadInput(
            f"'{path}' claims {count[1].decode() if count else 'no'} vertices", f"1 to {MAX_SPLATS}", "export it again"
        )


def _columns(table: NDArray[np.void], *names: str) -> Float32Array:
    try:
        with np.errstate(over="ignore"):
            return np.stack([table[name].astype(np.float32) for name in names], axis=1)
    except ValueError as error:
        raise BadInput(
            f"a splat file without {', '.join(names)} ({error})", "all of them", "export it again"
        ) from error


def _harmonics(table: NDArray[np.void], per_channel: int) -> Float32Array:
    """[N, 1 + per_channel, 3]: f_rest_{c * per_channel + k} is harmonic k + 1 of channel c."""
    names = ["f_dc_0", "f_dc_1", "f_dc_2"]
    first = _columns(table, *names)[:, None, :]
    if per_channel == 0:
        return first
    rest = _columns(table, *(f"f_rest_{i}" for i in range(3 * per_channel)))
    return np.concatenate([first, rest.reshape(len(table), 3, per_channel).transpose(0, 2, 1)], axis=1)
