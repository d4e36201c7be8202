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
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from orca.anchors import Stage
from orca.camera import Camera
from orca.cli import main
from orca.conventions import Float32Array, to_float
from orca.errors import BadInput
from orca.export import read_splats, write_splats
from orca.paths import make_path, path_cameras
from orca.pipeline import reconstruct
from orca.splats.bake import BakeConfig, bake
from orca.splats.model import Splats
from orca.splats.view import render_splats
from orca.view import SceneViewer, camera_pose, write_html
from tests.browser import Watched, open_page
from tests.orca import repair_scenes
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


def assert_switches_work(watched: Watched) -> None:
    """Each switch, pressed by a visitor, takes its own wall away and brings it back."""
    for k, (share, label) in enumerate(((0.25, "original (352)"), (0.5, "outpainted (352)"), (0.75, "repaired (352)"))):
        others = [(s, c) for c, s in enumerate((0.25, 0.5, 0.75)) if c != k]
        switch = watched.page.get_by_label(label, exact=True)
        assert switch.is_checked()
        switch.click()
        picture = wait_until(watched, lambda p, s=share, c=k: not shows(middle(p, s), c))
        assert not shows(middle(picture, share), k), label
        assert all(shows(middle(picture, s), c) for s, c in others), label
        switch.click()
        picture = wait_until(watched, lambda p, s=share, c=k: shows(middle(p, s), c))
        assert shows(middle(picture, share), k), label


def assert_path_and_input_view_work(
    watched: Watched, viewer: SceneViewer, splats: Splats, path: Sequence[Camera]
) -> None:
    """The play button moves the picture along the path, the slider to a frame, the button back to the input view."""
    page = watched.page

    def shows_view(camera: Camera) -> bool:
        return far_below(splats, camera, wait_until(watched, lambda p: far_below(splats, camera, p) < 0.01)) < 0.01

    def press(name: str) -> None:
        page.get_by_label(name, exact=True).click()

    def settled() -> bool:
        """The page is where the server is: its slider, and its picture of that frame."""
        frame = int(viewer.frame.value)
        return int(box.input_value()) == frame and far_below(splats, path[frame], screenshot(watched)) < 0.01

    box = page.locator("input[inputmode=decimal]")
    assert shows_view(CAMERA)
    for _ in range(4):
        press("Play")
        assert reached(page, lambda: far_below(splats, CAMERA, screenshot(watched)) > 0.02)
        press("Play")
        assert reached(page, lambda: not viewer.playing.value and settled())
        frame = 1 if viewer.frame.value != 1 else 3  # the slider stands where playing stopped
        box.fill(str(frame))
        box.press("Enter")
        assert shows_view(path[frame])
        assert not far_below(splats, CAMERA, screenshot(watched)) < 0.02
    press("Play")
    assert reached(page, lambda: bool(viewer.playing.value))
    page.get_by_role("button", name="Input view").click()
    assert reached(page, lambda: not viewer.playing.value)
    assert reached(page, lambda: int(box.input_value()) == viewer.frame.value)  # no frame is still on its way
    assert shows_view(CAMERA)


def far_below(splats: Splats, camera: Camera, picture: Float32Array) -> float:
    """Mean difference from our own renderer in the lower half, where no panel is."""
    expected = render_splats(splats, camera, background=float(picture[-1, 0].mean()))
    return float(np.abs(expected - picture)[HEIGHT // 2 :].mean())


def reached(page: Any, done: Callable[[], bool]) -> bool:
    """Whether it comes true within a minute."""
    for _ in range(300):
        if done():
            return True
        page.wait_for_timeout(200)
    return False


def test_camera_pose_of_a_turned_camera() -> None:
    """Turned to the right and then down: it looks ahead and down, and dragging turns about the first camera's up."""
    half = 0.5**0.5
    to_the_right = np.array([[0.0, 0, -1, 0.5], [0, 1, 0, 0], [1, 0, 0, -2], [0, 0, 0, 1]])
    down = np.array([[1.0, 0, 0, 0], [0, half, -half, 0], [0, half, half, 0], [0, 0, 0, 1]])
    pose = camera_pose(replace(CAMERA, world_to_camera=down @ to_the_right), CAMERA)
    assert pose.position == pytest.approx([2, 0, 0.5])
    assert pose.ahead == pytest.approx([half, half, 0])
    assert pose.up == pytest.approx([0, -1, 0])
    assert pose.fov == pytest.approx(2 * np.arctan(300 / CAMERA.K[1, 1]))


def test_camera_pose_of_a_rolled_camera() -> None:
    """Rolled by 45 degrees it stays rolled, and so does one that stands on its head."""
    half = 0.5**0.5
    rolled = np.array([[half, half, 0, 0], [-half, half, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    up = camera_pose(replace(CAMERA, world_to_camera=rolled), CAMERA).up
    assert up / np.linalg.norm(up) == pytest.approx([half, -half, 0])
    over = np.diag([-1.0, -1, 1, 1])
    assert camera_pose(replace(CAMERA, world_to_camera=over), CAMERA).up == pytest.approx([0, 1, 0])


@pytest.mark.slow
def test_a_visitor_sees_the_scene_and_the_controls_work() -> None:
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
            assert_switches_work(watched)
            assert_path_and_input_view_work(watched, viewer, splats, path)
            assert_clean(watched, viewer.url)


@pytest.mark.slow
def test_a_real_scene_and_its_repairs_from_the_side() -> None:
    """What the whole method made, baked: a visitor sees what our own renderer shows, with and without the repairs."""
    image, depth = repair_scenes.picture()
    camera, path = repair_scenes.input_camera(), repair_scenes.sideways(0.12)
    scene = reconstruct(image, camera, repair_scenes.estimate(depth), path, repair_scenes.small_config()).scene
    splats = bake(scene, path, BakeConfig(steps=20, rounds=0))
    repaired = int((splats.stage == int(Stage.REPAIRED)).sum())
    assert repaired > 20
    side = path[2].resized(HEIGHT, HEIGHT)
    kept = splats.stage != int(Stage.REPAIRED)
    with (
        SceneViewer(splats, camera, path, port=free_port()) as viewer,
        open_page(HEIGHT + 400, HEIGHT, webgl=True) as watched,
    ):
        watched.page.goto(viewer.url)
        assert reached(watched.page, lambda: len(viewer.server.get_clients()) == 1)
        box = watched.page.locator("input[inputmode=decimal]")
        box.fill("2")
        box.press("Enter")
        whole, without = splats, subset(splats, kept)
        for shown, hidden in ((whole, without), (without, whole)):
            picture = wait_until(watched, lambda p, s=shown, h=hidden: shows_rather(s, h, side, p))
            assert shows_rather(shown, hidden, side, picture)
            watched.page.get_by_label(f"repaired ({repaired:,})", exact=True).click()
        assert_clean(watched, viewer.url)


def subset(splats: Splats, kept: NDArray[np.bool_]) -> Splats:
    return Splats(*(getattr(splats, f.name)[kept] for f in fields(splats)))


def shows_rather(shown: Splats, hidden: Splats, camera: Camera, page: Float32Array) -> bool:
    """Whether the page is near to what should be seen, and much nearer than to what should not."""
    return far_from(shown, camera, page) < min(0.025, 0.7 * far_from(hidden, camera, page))


def far_from(splats: Splats, camera: Camera, page: Float32Array) -> float:
    """Mean difference from our own renderer, whose view is the middle of the page; left of the panel."""
    left = (page.shape[1] - camera.width) // 2
    background = float(np.median(page[-4:, :4]))
    expected = render_splats(splats, camera, background=background)
    return float(np.abs(expected - page[:, left : left + camera.width])[:, : 3 * camera.width // 4].mean())


@pytest.mark.slow
def test_one_file_shows_the_scene_without_a_server(tmp_path: Path) -> None:
    page = tmp_path / "scene.html"
    assert write_html(three_walls(), CAMERA, page) == page.stat().st_size
    with open_page(WIDTH, HEIGHT, webgl=True) as watched:
        watched.page.goto(page.as_uri())
        picture = wait_until(watched, lambda p: shows(middle(p, 0.5), 1))
        assert [shows(middle(picture, share), k) for k, share in enumerate((0.25, 0.5, 0.75))] == [True] * 3
        assert_clean(watched, page.as_uri())


@pytest.mark.slow
def test_the_flag_html_writes_a_page_that_shows_the_exported_splats(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    image, depth = repair_scenes.picture()
    camera, path = repair_scenes.input_camera(), repair_scenes.sideways(0.12)
    scene = reconstruct(image, camera, repair_scenes.estimate(depth), path, repair_scenes.small_config()).scene
    scene.save(tmp_path / "s.safetensors")
    ply, page = tmp_path / "s.ply", tmp_path / "s.html"
    options = ["--html", str(page), "--steps", "5", "--trajectory", "swing", "--json"]
    assert main(["export", str(tmp_path / "s.safetensors"), str(ply), *options]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert (answer["html"], answer["html_bytes"]) == (str(page), page.stat().st_size)
    splats = read_splats(ply)
    large, blank = camera.resized(HEIGHT, HEIGHT), subset(splats, splats.opacities < 0)
    with open_page(HEIGHT + 400, HEIGHT, webgl=True) as watched:
        watched.page.goto(page.as_uri())
        picture = wait_until(watched, lambda p: shows_rather(splats, blank, large, p))
        assert shows_rather(splats, blank, large, picture)
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


@pytest.mark.slow
def test_without_a_path_there_is_nothing_to_play() -> None:
    with (
        SceneViewer(three_walls(), CAMERA, port=free_port()) as viewer,
        open_page(WIDTH, HEIGHT, webgl=True) as watched,
    ):
        watched.page.goto(viewer.url)
        watched.page.get_by_role("button", name="Input view").wait_for()
        assert watched.page.get_by_label("repaired (352)", exact=True).count() == 1
        assert watched.page.get_by_label("Play", exact=True).count() == 0
        assert watched.page.locator("input[inputmode=decimal]").count() == 0


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
    small_scene(Camera.from_fov(32, 32, 60.0)).save(tmp_path / "s.safetensors")
    write_splats(three_walls(), tmp_path / "other.ply")
    assert main(["view", str(tmp_path / "s.safetensors"), "--ply", str(tmp_path / "other.ply")]) == 2
    assert "does not follow the scene's 1 anchors" in capsys.readouterr().err
