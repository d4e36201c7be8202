"""MATLAB files: what scipy writes is read as scipy reads it; what is broken is refused and kills nobody."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from bench.metrics.matlab_file import MAX_BYTES, read_matrices
from bench.metrics.natural_statistics import NiqePrior
from orca.errors import BadInput

RNG = np.random.default_rng(3)
ARRAYS: dict[str, Any] = {
    "wide": RNG.normal(size=(3, 5)),
    "single": RNG.normal(size=(4, 1)).astype(np.float32),
    "bytes": RNG.integers(0, 255, (2, 2), dtype=np.uint8),
    "deep": RNG.normal(size=(2, 3, 4)),
    "one": np.array([[7.0]]),
    "none": np.zeros((0, 3)),
}


@pytest.mark.parametrize("compressed", [False, True])
def test_the_same_as_scipy_reads(tmp_path: Path, compressed: bool) -> None:
    others = {"text": "abc", "cells": np.array(["a", 2], object), "complex": np.array([1j]), "struct": {"a": 1}}
    savemat(tmp_path / "a.mat", {**others, **ARRAYS}, do_compression=compressed)
    found, wanted = read_matrices(tmp_path / "a.mat", [*ARRAYS, "absent"]), loadmat(tmp_path / "a.mat")
    assert found.keys() == ARRAYS.keys()
    for name, array in found.items():
        assert array.dtype == np.float64
        assert array.shape == wanted[name].shape
        np.testing.assert_array_equal(array, wanted[name])
    assert read_matrices(tmp_path / "a.mat", ["complex", "text", "cells", "struct"]) == {}


@pytest.mark.data
def test_the_real_prior_is_read_as_scipy_reads_it(data_root: Path) -> None:
    path = data_root / "weights" / "niqe_modelparameters.mat"
    prior, wanted = NiqePrior.read(path), loadmat(path)
    np.testing.assert_array_equal(prior.mean, wanted["mu_prisparam"].ravel())
    np.testing.assert_array_equal(prior.covariance, wanted["cov_prisparam"])


def a_matrix(shape: tuple[int, ...], values: bytes, kind: int = 9) -> bytes:
    """One array "a", as bytes of a file."""
    dims = struct.pack(f"<II{len(shape)}i", 5, 4 * len(shape), *shape)
    parts = struct.pack("<IIII", 6, 8, 6, 0) + dims + b"\0" * (-len(dims) % 8)
    parts += struct.pack("<I", 1 << 16 | 1) + b"a\0\0\0" + struct.pack("<II", kind, len(values)) + values
    return struct.pack("<II", 14, len(parts)) + parts


HEADER = b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM"
SOUND = a_matrix((2, 1), struct.pack("<2d", 1, 2))
BOMB = zlib.compress(bytes(64 << 20), 9)


def test_a_file_made_by_hand_is_read(tmp_path: Path) -> None:
    (tmp_path / "a.mat").write_bytes(HEADER + SOUND)
    assert read_matrices(tmp_path / "a.mat", ["a"])["a"].tolist() == [[1.0], [2.0]]


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"", "no header"),
        (HEADER[:-2] + b"MI" + SOUND, "no header"),  # a big-endian machine
        (b"\x89HDF\r\n\x1a\n" + bytes(200), "no header"),  # version 7.3
        (HEADER + SOUND[:-1], "bytes claimed"),
        (HEADER + SOUND + b"abc", "ends early"),
        (HEADER + a_matrix((2**30, 2**30), bytes(8)), "bytes for shape"),
        (HEADER + a_matrix((-1, -1), bytes(8)), "shape"),
        (HEADER + a_matrix((1, 1), bytes(8), 99), "type 99"),
        (HEADER + struct.pack("<II", 15, len(BOMB)) + BOMB, "a compressed part of more than"),
        (HEADER + struct.pack("<II", 15, 4) + b"zlib", "incorrect header"),
        (HEADER + bytes(MAX_BYTES), "bytes"),
    ],
)
def test_what_is_broken_is_refused(tmp_path: Path, content: bytes, why: str) -> None:
    (tmp_path / "a.mat").write_bytes(content)
    with pytest.raises(BadInput, match=why):
        read_matrices(tmp_path / "a.mat", ["a"])
