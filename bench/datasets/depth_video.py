"""Depth maps of RealmDreamer's scenes from VistaDream's published depth videos.

VistaDream writes ``(z - p1) / (p99 - p1)``, cut to [0, 1], of the rendered z-depth over all frames of a video, in grey
or through a colour map of matplotlib, as H.264. Frame 0 is the input view. So z / R = a + b v, where v is the value
that a pixel shows; a and b belong to the scene (``depth_affine`` in ``scenes.json``, gauged with points triangulated in
the colour video). What lies beyond the 99th percentile is cut to a + b.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from bench.datasets.manifest import REALMDREAMER_SCENES, depth_video_url
from orca.array_file import read_png
from orca.atomic import atomic_path
from orca.conventions import Float32Array, Float64Array, UInt8Array
from orca.errors import BadInput, Unavailable
from orca.json_file import read_json_file
from orca.video import read_video

__all__ = ["COLOUR_MAPS", "DepthScene", "decode_values", "rebuild_depth"]

COLOUR_MAPS = ("gray", "plasma", "Spectral", "viridis", "inferno", "magma", "turbo", "jet")
_STEP = 1e-4  # R per unit of the 16-bit depth maps
_LEVELS = 1024
_WORST_FIT = 20.0  # median distance to the colour map, in grey levels: more is no such video


@dataclass(frozen=True)
class DepthScene:
    """What became of one scene.

    Attributes:
        scene: its name.
        file: the depth map.
        written: False if a depth map was there: it was compared with, and left alone.
        colour_map: by which the values were read.
        fit: median distance of the video's colours to that map, in grey levels.
        difference: median relative difference to the map that was there, or None.
        difference_p90: 90th percentile of it.
    """

    scene: str
    file: Path
    written: bool
    colour_map: str
    fit: float
    difference: float | None = None
    difference_p90: float | None = None

    def line(self) -> str:
        """One line for people."""
        done = f"wrote {self.file}" if self.written else f"{self.file} was there and stays"
        against = ""
        if self.difference is not None and self.difference_p90 is not None:
            against = (
                f"; differs from it by {100 * self.difference:.2f} % median, {100 * self.difference_p90:.2f} % p90"
            )
        return f"{self.scene}: {done}; read through '{self.colour_map}' ({self.fit:.1f} grey levels off){against}"

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self) | {"file": str(self.file)}


def rebuild_depth(root: Path, scene: str, out: Path) -> DepthScene:
    """Write ``<out>/<scene>.png`` (16 bits, 1e-4 R) from ``<root>/vistadream/dpt/<scene>.mp4``.

    A depth map that is there already is kept, and the difference reported.

    Raises:
        Unavailable: the depth video is not here; says where it is published.
        BadInput: a video that is no depth video, or a scene without its affine map.
    """
    video = root / "vistadream" / "dpt" / f"{scene}.mp4"
    if not video.is_file():
        raise Unavailable(
            f"no depth video {video}",
            f"VistaDream's published one, {depth_video_url(scene)}",
            "fetch it by hand and put it there: its hash is not pinned, so `bench download` leaves it out",
        )
    a, b = _affine(root, scene)
    values, name, fit = decode_values(read_video(video, (0,))[0])
    size = (512, 512)
    if values.shape != size:
        values = np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_LINEAR), np.float32)
    depth = a + b * values.astype(np.float64)
    stored = np.clip(np.round(depth / _STEP), 1, 65535).astype(np.uint16)
    file = out / f"{scene}.png"
    before = read_png(file) if file.is_file() else None
    if before is not None:
        return DepthScene(scene, file, False, name, fit, *_difference(stored, before, file))
    encoded, content = cv2.imencode(".png", stored)
    if not encoded:
        raise BadInput(f"a depth map of shape {stored.shape}", "one that OpenCV writes", "report this")
    with atomic_path(file) as temporary:
        temporary.write_bytes(content.tobytes())
    return DepthScene(scene, file, True, name, fit)


def decode_values(frame: UInt8Array) -> tuple[Float32Array, str, float]:
    """Values in [0, 1] that a frame [H, W, 3] shows through the colour map of `COLOUR_MAPS` that fits it best.

    Each pixel gets the value of the nearest colour of the map (1024 steps).

    Returns:
        values [H, W], the map's name, and the median distance of the colours to it in grey levels.

    Raises:
        BadInput: no map fits.
    """
    from scipy.spatial import cKDTree

    packed = frame.astype(np.uint32) @ np.array([1 << 16, 1 << 8, 1], np.uint32)
    codes, place = np.unique(packed, return_inverse=True)  # far fewer colours than pixels
    colours = np.stack([codes >> 16, codes >> 8 & 255, codes & 255], axis=1).astype(np.float64)
    sample = frame.reshape(-1, 3)[:: max(1, frame.size // (3 * 4096))].astype(np.float64)
    trees = {name: cKDTree(_colours(name)) for name in COLOUR_MAPS}
    fits = {name: float(np.median(tree.query(sample)[0])) for name, tree in trees.items()}
    best = min(fits, key=lambda name: fits[name])
    if fits[best] > _WORST_FIT:
        raise BadInput(
            f"a frame whose colours are {fits[best]:.0f} grey levels off every colour map",
            f"a depth video through {', '.join(COLOUR_MAPS)}",
            "check that it is the depth video",
        )
    _, index = trees[best].query(colours)
    values = (index / (_LEVELS - 1)).astype(np.float32)
    return values[place.reshape(frame.shape[:2])], best, fits[best]


def _colours(name: str) -> Float64Array:
    import matplotlib

    colours: Float64Array = np.asarray(matplotlib.colormaps[name](np.linspace(0, 1, _LEVELS)), np.float64)[:, :3]
    return colours * 255.0


def _affine(root: Path, scene: str) -> tuple[float, float]:
    """a and b of z / R = a + b v, from ``scenes.json`` if it has them, else those that come with this package."""
    path = root / "realmdreamer" / "scenes.json"
    entry: dict[str, Any] = {}
    if path.is_file():
        document = read_json_file(path, "an object of scenes", "get it again")
        found = document.get(scene) if isinstance(document, dict) else None
        entry = found if isinstance(found, dict) else {}
    values = entry.get("depth_affine") or REALMDREAMER_SCENES.get(scene, {}).get("depth_affine")
    if not (isinstance(values, list) and len(values) == 2 and all(isinstance(v, int | float) for v in values)):
        raise BadInput(f"no depth_affine of scene '{scene}'", "two numbers a, b", "add it to scenes.json")
    return float(values[0]), float(values[1])


def _difference(ours: np.ndarray[Any, Any], theirs: np.ndarray[Any, Any], file: Path) -> tuple[float, float]:
    if theirs.shape != ours.shape or theirs.dtype != np.uint16:
        raise BadInput(f"{file} of shape {theirs.shape}, {theirs.dtype}", "512x512, 16 bits", "move it away")
    relative = np.abs(ours.astype(np.float64) - theirs) / np.maximum(theirs, 1)
    return float(np.median(relative)), float(np.percentile(relative, 90))
