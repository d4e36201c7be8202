"""The viewer, as a browser sees it: the real server on this machine, and the file that needs none."""

from __future__ import annotations

import io
import json
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from orca.camera import Camera
from orca.cli import main
from orca.conventions import Float32Array, to_float
from orca.errors import BadInput
from orca.paths import make_path, path_cameras
from orca.splats.model import Splats
from orca.splats.view import render_splats
from orca.view import SceneViewer, camera_pose, write_html
from tests.browser import Watched, open_page
from tests.orca.test_orca_cli import small_scene

pytest.importorskip("viser", reason="viser is not installed")

WIDTH, HEIGHT = 900, 600
CAMERA = Camera.from_fov(WIDTH, HEIGHT, 60.0)


def three_walls() -> Splats:
    """A red, a green and a blue patch side by side, one of each stage."""
    y, x = np.meshgrid(np.linspace(-0.4, 0.4, 32), np.linspace(-0.12, 0.12, 11), indexing="ij")
    patch = np.stack([x.ravel(), y.ravel(), np.full(x.size, 1.0)], 1)
    n = len(patch)
    return Splats(
        means=np.concatenate([patch + np.array([offset, 0, 0]) for offset in (-0.3, 0, 0.3)]).astype(np.float32),
        log_scales=np.full((3 * n, 3), np.log(0.015), np.float32),
        quaternions=np.tile(np.array([1, 0, 0, 0], np.float32), (3 * n, 1)),
        colours=np.repeat(np.eye(3, dtype=np.float32) * 0.8, n, 0),
        opacities=np.full(3 * n, 0.95, np.float32),
        stage=np.repeat(np.arange(3, dtype=np.uint8), n),
    )


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def screenshot(watched: Watched) -> Float32Array:
    picture = Image.open(io.BytesIO(watched.page.screenshot())).convert("RGB")
    return to_float(np.asarray(picture))


def wait_until(watched: Watched, good: Callable[[Float32Array], bool]) -> Float32Array:
    """Screenshots until one is good, or the last of a minute."""
    deadline = time.monotonic() + 60
    while True:
        picture = screenshot(watched)
        if good(picture) or time.monotonic() > deadline:
            return picture
        watched.page.wait_for_timeout(300)


def middle(picture: Float32Array, share: float) -> list[float]:
    """Colour at a share of the width, low in the picture, where no panel is."""
    return picture[int(0.8 * picture.shape[0]), int(share * picture.shape[1])].tolist()


def shows(colour: list[float], channel: int) -> bool:
    return colour[channel] > 0.5 and max(colour[:channel] + colour[channel + 1 :]) < 0.3


def assert_clean(watched: Watched, origin: str) -> None:
    # three.js has a word on viser's own empty line objects; it is not about ours.
    assert [e for e in watched.errors if "computeBoundingSphere" not in e] == []
    assert [r for r in watched.requests if not r.startswith(origin)] == []


def test_camera_pose_of_a_turned_camera() -> None:
    pose = np.array([[0.0, 0, -1, 0.5], [0, 1, 0, 0], [1, 0, 0, -2], [0, 0, 0, 1]])
    wxyz, position, fov = camera_pose(replace(CAMERA, world_to_camera=pose))
    half = 0.5**0.5
    assert np.abs(wxyz) == pytest.approx([half, 0, half, 0])
    assert wxyz[0] * wxyz[2] > 0  # the camera's z is the world's x
    assert position == pytest.approx((2, 0, 0.5))
    assert fov == pytest.approx(2 * np.arctan(300 / CAMERA.K[1, 1]))


@pytest.mark.slow
def test_a_visitor_sees_the_scene_and_the_switches_work() -> None:
    splats = three_walls()
    path = path_cameras(make_path("dolly", 5), CAMERA)
    with SceneViewer(splats, CAMERA, path, port=free_port()) as viewer:
        assert viewer.url.startswith("http://127.0.0.1:")
        with open_page(WIDTH, HEIGHT, webgl=True) as watched:
            watched.page.goto(viewer.url)
            wait_until(watched, lambda p: shows(middle(p, 0.5), 1))
            picture = wait_until(watched, lambda p: shows(middle(p, 0.25), 0))
            assert [shows(middle(picture, share), k) for k, share in enumerate((0.25, 0.5, 0.75))] == [True] * 3
            # The same place from our own renderer, away from the panel on top: the camera is the input's.
            expected = render_splats(splats, CAMERA, background=float(picture[-1, 0].mean()))
            difference = [
                float(np.abs(np.roll(expected, shift, axis=1) - picture)[HEIGHT // 2 :].mean()) for shift in (-1, 0, 1)
            ]
            assert difference[1] < 0.01
            assert difference[1] == min(difference)  # not a pixel off
            viewer.handles["original (352)"].visible = False
            picture = wait_until(watched, lambda p: not shows(middle(p, 0.25), 0))
            assert not shows(middle(picture, 0.25), 0)
            assert shows(middle(picture, 0.5), 1)
            before = screenshot(watched)
            viewer.frame.value = 1
            moved = wait_until(watched, lambda p: float(np.abs(p - before).mean()) > 0.01)
            assert float(np.abs(moved - before).mean()) > 0.01
            (client,) = viewer.server.get_clients().values()
            assert np.asarray(client.camera.position) == pytest.approx(
                100 * path[1].center, abs=1e-2
            )  # the walls are at 1
            assert_clean(watched, viewer.url)


@pytest.mark.slow
def test_one_file_shows_the_scene_without_a_server(tmp_path: Path) -> None:
    page = tmp_path / "scene.html"
    assert write_html(three_walls(), CAMERA, page) == page.stat().st_size
    with open_page(WIDTH, HEIGHT, webgl=True) as watched:
        watched.page.goto(page.as_uri())
        picture = wait_until(watched, lambda p: shows(middle(p, 0.5), 1))
        assert [shows(middle(picture, share), k) for k, share in enumerate((0.25, 0.5, 0.75))] == [True] * 3
        assert_clean(watched, page.as_uri())


def test_playing_moves_along_the_path() -> None:
    path = path_cameras(make_path("dolly", 5), CAMERA)
    with SceneViewer(three_walls(), CAMERA, path, port=free_port(), fps=200) as viewer:
        viewer.playing.value = True
        seen = set()
        deadline = time.monotonic() + 30
        while len(seen) < 5 and time.monotonic() < deadline:
            seen.add(int(viewer.frame.value))
        assert seen == {0, 1, 2, 3, 4}


def test_places_that_cannot_be_listened_on_are_refused() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        for host, port in (
            ("127.0.0.1", taken.getsockname()[1]),
            ("127.0.0.1", 0),
            ("203.0.113.7", 8080),
            ("a b", 8080),
        ):
            with pytest.raises(BadInput):
                SceneViewer(three_walls(), CAMERA, host=host, port=port)


@pytest.mark.slow
def test_the_verb_serves_until_interrupted(tmp_path: Path) -> None:
    small_scene(Camera.from_fov(32, 32, 60.0)).save(tmp_path / "s.safetensors")
    port = free_port()
    command = [sys.executable, "-m", "orca", "view", str(tmp_path / "s.safetensors"), "--steps", "1", "--json"]
    # A test run in the background ignores Ctrl-C, and its children would inherit that.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    process = subprocess.Popen([*command, "--port", str(port)], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    signal.signal(signal.SIGINT, before)
    with process:
        try:
            assert process.stderr is not None
            assert any(f"http://127.0.0.1:{port} shows 1 splats".encode() in line for line in process.stderr)
            with urllib.request.urlopen(f"http://127.0.0.1:{port}", timeout=60) as answer:
                assert answer.status == 200
            process.send_signal(signal.SIGINT)
            out, _ = process.communicate(timeout=120)
        finally:
            process.kill()
    assert json.loads(out) == {"url": f"http://127.0.0.1:{port}", "splats": 1}


def test_the_verb_refuses_another_scenes_splats(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from orca.export import write_splats

    small_scene(Camera.from_fov(32, 32, 60.0)).save(tmp_path / "s.safetensors")
    write_splats(three_walls(), tmp_path / "other.ply")
    assert main(["view", str(tmp_path / "s.safetensors"), "--ply", str(tmp_path / "other.ply")]) == 2
    assert "a scene of 1 anchors" in capsys.readouterr().err
