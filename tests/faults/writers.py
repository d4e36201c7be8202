"""What is killed: each writer of a single file. Everything is imported here, once, before the forks."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from bench.datasets.archives import unpack
from bench.store import write_atomic
from bench.trajectories import build_trajectory, save_trajectory
from orca.camera import Camera
from orca.commands import _write_json
from orca.export import export_ply
from orca.images import save_image
from orca.video import write_video
from tests.bench.test_adapter_orca_scene import wall_scene

__all__ = ["WRITERS", "writer_job"]


def writer_job(writer: str, out: str) -> None:
    """One of `WRITERS`, into the file ``out``."""
    WRITERS[writer](Path(out))


def _write_scene(path: Path) -> None:
    wall_scene(2.0).save(path)


def _write_splats(path: Path) -> None:
    export_ply(wall_scene(2.0), path)


def _write_video(path: Path) -> None:
    write_video(path, np.zeros((3, 32, 32, 3), np.uint8))


def _write_image(path: Path) -> None:
    save_image(path, np.zeros((20, 20, 3), np.uint8))


def _write_ledger(path: Path) -> None:
    _write_json(path, {"repairs": []})


def _write_cameras(path: Path) -> None:
    save_trajectory(build_trajectory("swing", Camera.from_fov(8, 8, 60.0)), path)


def _write_page(path: Path) -> None:
    write_atomic(path, b"<!doctype html>")


def _write_archive_member(path: Path) -> None:

    archive = path.with_name("archive.zip")
    with zipfile.ZipFile(archive, "w") as opened:
        opened.writestr(path.name, b"content" * 100)
    unpack(archive, path.parent, 1 << 20)
    archive.unlink()


WRITERS = {
    "scene.safetensors": _write_scene,
    "splats.ply": _write_splats,
    "preview.mp4": _write_video,
    "preview.png": _write_image,
    "ledger.json": _write_ledger,
    "cameras.json": _write_cameras,
    "report.html": _write_page,
    "unpacked.bin": _write_archive_member,
}
