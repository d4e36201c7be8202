"""Cases of ORCA's command line, and of the machine: files that are not what they should be, no room, no memory."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path

import numpy as np

from bench.stability.case import StabilityCase
from bench.stability.outcome import CONTAINED, FINISHED, OUT_OF_MEMORY, TYPED
from bench.stability.scenes import SIZE, make_scene, object_depth, write_picture
from orca.conventions import Float32Array
from orca.paths import make_path

__all__ = ["COMMAND_CASES", "MACHINE_CASES"]

_ROOM = 20_000  # bytes that a file may have on the small disk
_SPARE = 64 * 2**20  # bytes of address space left where memory is short


def _with_depth(folder: Path, depth: Float32Array, options: str) -> list[str]:
    np.save(folder / "depth.npy", depth)
    return [str(write_picture(folder / "image.png")), "--depth", f"file:{folder / 'depth.npy'}?{options}"]


def _depth(name: str, about: str, depth: Float32Array, options: str, expected: tuple[str, ...]) -> StabilityCase:
    return StabilityCase(
        name, "command line", about, expected, command=lambda folder: _with_depth(folder, depth, options)
    )


def _holed() -> Float32Array:
    depth = object_depth()
    depth[20:50, 30:70] = np.nan
    return depth


def _network(folder: Path, spec: str) -> list[str]:
    (folder / "net.onnx").write_bytes(b"\x08\x07not a network")
    return [str(write_picture(folder / "image.png")), "--depth", spec.format(folder / "net.onnx")]


def _cameras(folder: Path, poses: object) -> list[str]:
    K = [[110.0, 0, SIZE / 2], [0, 110.0, SIZE / 2], [0, 0, 1]]
    document = {"name": "mine", "width": SIZE, "height": SIZE, "K": K, "world_to_camera": poses}
    (folder / "path.json").write_text(json.dumps(document))
    return [*_with_depth(folder, object_depth(), "unit=1"), "--trajectory", str(folder / "path.json")]


def _path(name: str, about: str, poses: object) -> StabilityCase:
    return StabilityCase(name, "command line", about, _REFUSED, command=lambda folder: _cameras(folder, poses))


def _nan_poses() -> object:
    poses = make_path("swing", 5)
    poses[1, 1, 3] = np.nan
    return poses.tolist()


def _unicode(folder: Path) -> list[str]:
    place = folder / "Straße 東京"
    place.mkdir()
    return _with_depth(place, object_depth(), "unit=1")


def _out_is_file(folder: Path) -> list[str]:
    (folder / "taken").write_text("a file")
    return [*_with_depth(folder, object_depth(), "unit=1"), "--out", str(folder / "taken")]


def _out_unwritable(folder: Path) -> list[str]:
    return [*_with_depth(folder, object_depth(), "unit=1"), "--out", "/proc/stability"]


@contextmanager
def small_disk() -> Iterator[None]:
    """No file may grow beyond 20 kB; writing more fails as on a full disk."""
    import resource

    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (_ROOM, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@contextmanager
def short_of_memory() -> Iterator[None]:
    """No more than 64 MB of address space beyond what the process has, once the libraries of a method are loaded."""
    import resource

    import_module("orca.pipeline")  # a library that cannot be mapped says nothing about a method

    before = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + _SPARE, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


_REFUSED = (TYPED,)
_SKY = np.zeros((SIZE, SIZE), np.float32)

COMMAND_CASES = (
    _depth("sky-inverse-depth", "inverse depth 0 everywhere: nothing but sky", _SKY, "meaning=inverse_depth", _REFUSED),
    _depth("sky-filled", "the same, with leave to fill", _SKY, "meaning=inverse_depth&fill=1", (*FINISHED, TYPED)),
    _depth("holed-depth", "a depth file with NaN", _holed(), "unit=1", _REFUSED),
    _depth("holed-depth-filled", "the same, with leave to fill", _holed(), "unit=1&fill=1", FINISHED),
    _depth("small-depth", "a depth file of half the size", object_depth(64, 64), "unit=1", _REFUSED),
    _depth("small-depth-resized", "the same, with leave to resize", object_depth(64, 64), "unit=1&resize=1", FINISHED),
    StabilityCase(
        "broken-network",
        "command line",
        "a depth network that is none",
        _REFUSED,
        command=lambda folder: _network(folder, "onnx:{}?size=64&range=255&meaning=inverse_depth"),
    ),
    StabilityCase(
        "broken-network-auto",
        "command line",
        "the same, with leave to take another",
        FINISHED,
        command=lambda folder: _network(folder, "auto:{}?size=64&range=255&meaning=inverse_depth"),
    ),
    _path("nan-camera-file", "a camera file with a NaN", _nan_poses()),
    _path("empty-camera-file", "a camera file without a camera", []),
    _path("ragged-camera-file", "a camera file with poses of different shapes", [[[1, 0], [0, 1]], [1]]),
    StabilityCase("unicode-folder", "command line", "umlauts and ideographs in a path", FINISHED, command=_unicode),
    StabilityCase("out-is-a-file", "command line", "results into a file", _REFUSED, command=_out_is_file),
    StabilityCase(
        "out-unwritable", "command line", "results where nobody may write", _REFUSED, command=_out_unwritable
    ),
)

MACHINE_CASES = (
    StabilityCase(
        "full-disk",
        "machine",
        f"no file may grow beyond {_ROOM // 1000} kB",
        _REFUSED,
        command=lambda folder: _with_depth(folder, object_depth(), "unit=1"),
        around=small_disk,
    ),
    StabilityCase(
        "short-of-memory",
        "machine",
        f"{_SPARE // 2**20} MB of memory left for an image of 1024x1024 pixels",
        (TYPED, OUT_OF_MEMORY),
        CONTAINED,
        scene=lambda folder: make_scene(np.full((1024, 1024, 3), 90, np.uint8)),
        around=short_of_memory,
    ),
)
