"""What is killed: each writer of a single file. Everything is imported here, once, before the forks."""

from __future__ import annotations

import hashlib
import threading
import zipfile
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import numpy as np

from bench.datasets.archives import unpack
from bench.datasets.fetch import Fetcher
from bench.store import write_atomic
from bench.trajectories import build_trajectory, save_trajectory
from orca.camera import Camera
from orca.commands import _write_json
from orca.export import export_ply
from orca.faults import STEPS
from orca.images import save_image
from orca.video import write_video
from tests.bench.test_adapter_orca_scene import wall_scene

__all__ = ["WRITERS", "steps_of", "writer_job"]


def writer_job(writer: str, out: str) -> None:
    """One of `WRITERS`, into the file ``out``."""
    WRITERS[writer](Path(out))


def steps_of(writer: str) -> tuple[str, ...]:
    """The steps at which it can be struck; a download keeps what it has in a file of its own until that is checked."""
    return ("written", "named") if writer == "download.bin" else STEPS


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


class _Gives(BaseHTTPRequestHandler):
    content = b"content" * 100

    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Length", str(len(self.content)))
        self.end_headers()
        self.wfile.write(self.content)

    def log_message(self, format: str, *args: object) -> None:
        pass


def _write_download(path: Path) -> None:
    with HTTPServer(("127.0.0.1", 0), _Gives) as server:
        threading.Thread(target=server.handle_request, daemon=True).start()
        digest = hashlib.sha256(_Gives.content).hexdigest()
        url = f"http://127.0.0.1:{server.server_port}/"
        Fetcher(allows=lambda _: True, attempts=1).fetch(url, path, digest, 1000)


WRITERS = {
    "scene.safetensors": _write_scene,
    "splats.ply": _write_splats,
    "preview.mp4": _write_video,
    "preview.png": _write_image,
    "ledger.json": _write_ledger,
    "cameras.json": _write_cameras,
    "report.html": _write_page,
    "unpacked.bin": _write_archive_member,
    "download.bin": _write_download,
}
