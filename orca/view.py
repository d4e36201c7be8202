"""A scene in the browser: a viser server on this machine, or one HTML file that needs no server."""

from __future__ import annotations

import asyncio
import errno
import math
import socket
import sys
import threading
from collections.abc import Sequence
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from orca.anchors import Stage
from orca.atomic import atomic_path
from orca.camera import Camera
from orca.conventions import Float64Array
from orca.errors import BadInput, Unavailable
from orca.splats.model import Splats

__all__ = ["Pose", "SceneViewer", "camera_pose", "write_html"]

_PATH_COLOUR = (120, 150, 190)
# Half of the scene lies nearer than this many units of the viewer's world. viser keeps covariances in half precision,
# whose small numbers browsers may take for zero: a pixel's variance in scene radii is 5e-6, here 0.05.
_MEDIAN_DEPTH = 100.0


class Pose(NamedTuple):
    """A camera as viser's orbit controls take it, in the scene's units; each of position, ahead, up is (3,).

    Attributes:
        position: where the camera stands.
        ahead: unit vector of its optical axis.
        up: axis that dragging turns about; what of it is across the axis is the picture's up.
        fov: vertical field of view in radians.
    """

    position: Float64Array
    ahead: Float64Array
    up: Float64Array
    fov: float


def camera_pose(camera: Camera, upright: Camera) -> Pose:
    """A camera's pose, whose up is that of ``upright`` less what of it is along the camera's own right.

    A camera that stands on its head against ``upright``, or nearly lies, keeps its own up.
    """
    right, down, ahead = camera.rotation
    level = -upright.rotation[1]
    level = level - (level @ right) * right
    up = level if level @ -down > 0.05 else -down
    return Pose(camera.center, ahead, up, 2 * math.atan(camera.height / (2 * camera.K[1, 1])))


class SceneViewer:
    """Serves splats until it is closed; a context manager.

    The page has a switch for each kind of splat, a slider along the path and a switch that plays it.

    Args:
        splats: what to show.
        camera: the input view, where the page opens.
        path: cameras of the playback; may be empty.
        host: address to listen on; anything but a loopback address shows the scene to the network.
        port: port to listen on, 1 to 65535.
        fps: frames a second of the playback.

    Raises:
        Unavailable: viser is not installed.
        BadInput: an address or port that cannot be listened on.
    """

    def __init__(
        self,
        splats: Splats,
        camera: Camera,
        path: Sequence[Camera] = (),
        host: str = "127.0.0.1",
        port: int = 8080,
        fps: float = 20.0,
    ) -> None:
        _check_free(host, port)
        self._input, self._path, self._fps = camera, tuple(path), fps
        self.server = _server(host, port)
        self._unit = _unit(splats, camera)
        self.handles = _add_scene(self.server, splats, camera, self._path, self._unit)
        self._closed = threading.Event()
        self._add_controls()
        self._player = threading.Thread(target=self._play, daemon=True)
        self._player.start()

    @property
    def url(self) -> str:
        """Where the page is."""
        host = self.server.get_host()
        shown = f"[{host}]" if ":" in host else host
        return f"http://{shown}:{self.server.get_port()}"

    def wait(self) -> None:
        """Return when the viewer is closed."""
        self._closed.wait()

    def close(self) -> None:
        """Stop serving."""
        self._closed.set()
        self._player.join()
        _stop(self.server)

    def __enter__(self) -> SceneViewer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _add_controls(self) -> None:
        gui = self.server.gui
        gui.configure_theme(
            dark_mode=True, show_logo=False, show_share_button=False
        )  # sharing would send the scene away
        with gui.add_folder("Anchors"):
            for name, handle in self.handles.items():
                self._add_switch(name, handle)
        with gui.add_folder("Camera"):
            home = gui.add_button("Input view")
            home.on_click(self._go_home)
            last = max(1, len(self._path) - 1)
            shown = len(self._path) > 1  # not only disabled: that leaves the number beside the slider to be typed
            self.frame = gui.add_slider("Path", 0, last, 1, 0, visible=shown)
            self.playing = gui.add_checkbox("Play", False, visible=shown)
            self.frame.on_update(self._follow_slider)

    def _add_switch(self, name: str, handle: Any) -> None:
        switch = self.server.gui.add_checkbox(name, True)

        def toggled(_: object) -> None:
            handle.visible = switch.value

        switch.on_update(toggled)

    # What moves cameras runs on the server's event loop, as what visitors send does: one after the other.

    async def _follow_slider(self, event: Any) -> None:
        if event.client is not None:  # a visitor's; what is played has moved the camera already
            self._move(self._path[int(self.frame.value)])

    async def _go_home(self, _: object) -> None:
        self.playing.value = False
        self._move(self._input)

    async def _advance(self) -> None:
        """Next frame while Play is on; the slider is the visitor's when it is off."""
        playing = bool(self.playing.value)
        if self.frame.disabled != playing:
            self.frame.disabled = playing
        if playing:
            self.frame.value = (int(self.frame.value) + 1) % len(self._path)
            self._move(self._path[self.frame.value])

    def _play(self) -> None:
        while len(self._path) > 1 and not self._closed.wait(1 / self._fps):
            asyncio.run_coroutine_threadsafe(self._advance(), self.server.get_event_loop()).result()

    def _move(self, camera: Camera) -> None:
        pose = camera_pose(camera, self._input)
        for client in self.server.get_clients().values():
            with client.atomic():
                _set_pose(client.camera, pose, self._unit)


def _set_pose(view: Any, pose: Pose, unit: float) -> None:
    """Send a visitor's browser a whole pose, whatever is known of where the visitor is.

    viser sends nothing when a value is what it holds already, but that may be what a slow browser reported of the frame
    it showed a while ago: each value is set to another first, which the second replaces before it is sent.
    """
    place, ahead, up, fov = pose.position * unit, pose.ahead, pose.up, pose.fov
    values = (
        ("position", place - ahead, place),
        ("look_at", place + ahead, place + ahead * _MEDIAN_DEPTH),
        ("up_direction", up + ahead, up),
        ("fov", 0.9 * fov, fov),
    )
    for name, other, wanted in values:
        setattr(view, name, other)
        setattr(view, name, wanted)


def write_html(splats: Splats, camera: Camera, file: Path) -> int:
    """Write the splats and viser's client into one HTML file that opens without a server; return its bytes.

    Raises:
        Unavailable: viser is not installed.
        BadInput: a path that cannot be written.
    """
    server = _server("127.0.0.1", _free_port())
    try:
        # In one piece: what cannot be sorted is drawn piece by piece, repairs over what they are hidden by.
        whole = replace(splats, stage=np.zeros_like(splats.stage))
        _add_scene(server, whole, camera, (), _unit(splats, camera))
        page = server.scene.as_html(dark_mode=True)
    finally:
        _stop(server)
    with atomic_path(file) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return Path(file).stat().st_size


def _server(host: str, port: int) -> Any:
    try:
        import viser
    except ImportError as error:
        raise Unavailable("viser is not installed", "viser >= 0.2", "pip install 'orca-nvs[view]'") from error
    with redirect_stdout(sys.stderr):  # viser greets on stdout, which is for answers
        return viser.ViserServer(host=host, port=port, label="ORCA", verbose=False)


def _stop(server: Any) -> None:
    with redirect_stdout(sys.stderr):
        server.stop()


def _unit(splats: Splats, camera: Camera) -> float:
    """Units of the viewer's world in one of the scene's."""
    depth = (splats.means - camera.center) @ camera.rotation[2]
    ahead = depth[depth > 0]
    return _MEDIAN_DEPTH / float(np.median(ahead)) if len(ahead) else 1.0


def _add_scene(server: Any, splats: Splats, camera: Camera, path: Sequence[Camera], unit: float) -> dict[str, Any]:
    """Put the splats, the path and the first camera into a server; returns the splats' handles by name and count."""
    scene = server.scene
    scene.set_up_direction("-y")
    pose = camera_pose(camera, camera)
    server.initial_camera.position = pose.position * unit
    server.initial_camera.look_at = pose.position * unit + pose.ahead * _MEDIAN_DEPTH
    server.initial_camera.up = pose.up
    server.initial_camera.fov = pose.fov
    # viser sorts by itself, but not before its sorter is up, and never in a page opened as a file: start in order.
    far_first = np.argsort(-(splats.means @ camera.rotation[2]), kind="stable")
    handles = {}
    for stage in Stage:
        chosen = far_first[splats.stage[far_first] == stage]
        if not len(chosen):
            continue
        name = stage.name.lower()
        handles[f"{name} ({len(chosen):,})"] = scene.add_gaussian_splats(
            f"/{name}",
            centers=splats.means[chosen] * np.float32(unit),
            covariances=splats.covariances()[chosen] * np.float32(unit) ** 2,
            rgbs=np.clip(splats.colours[chosen], 0, 1),
            opacities=splats.opacities[chosen, None],
        )
    if len(path) > 1:
        places = np.stack([view.center for view in path])
        scene.add_spline_catmull_rom("/path", points=places * unit, thickness=0.1, color=_PATH_COLOUR, visible=False)
    return handles


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _check_free(host: str, port: int) -> None:
    """viser takes the next port when one is taken; whoever asked for a port should hear of it instead."""
    if not 1 <= port <= 65535:
        raise BadInput(f"port {port}", "1 to 65535", "give another --port")
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except OSError as error:
        taken = getattr(error, "errno", None) == errno.EADDRINUSE
        fix = "give another --port" if taken else "use --host 127.0.0.1"
        raise BadInput(
            f"cannot listen on {host} port {port} ({error})", "a free address of this machine", fix
        ) from error
