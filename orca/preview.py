"""A look at a scene: a video along a path, and one picture with several of its views."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from orca.camera import Camera
from orca.conventions import UInt8Array, to_uint8
from orca.images import save_image
from orca.progress import Progress
from orca.video import write_video

if TYPE_CHECKING:
    from orca.scene import Scene

__all__ = ["contact_sheet", "render_frames", "write_preview"]

_COVERED = 0.5  # accumulated alpha of a pixel that shows something
_SHEET_WIDTH = 1536
_SHEET_VIEWS = 6


def _silent(phase: str, done: int, total: int) -> None:
    """No progress is shown."""


def render_frames(
    scene: Scene, cameras: Sequence[Camera], device: str = "cpu", progress: Progress = _silent
) -> Iterator[UInt8Array]:
    """Render a path frame by frame, each [H, W, 3] uint8; ``progress("render", done, total)`` after each."""
    for frame, _ in _rendered(scene, cameras, device, progress):
        yield frame


def _rendered(
    scene: Scene, cameras: Sequence[Camera], device: str, progress: Progress
) -> Iterator[tuple[UInt8Array, float]]:
    """Frames, and the share of each that nothing of the scene covers."""
    from orca.render.surroundings import as_shown  # loads torch

    renderer = scene.renderer(device)
    for index, camera in enumerate(cameras):
        view = as_shown(renderer.render(camera), scene.render_config)
        yield to_uint8(view.rgb), float(np.mean(~(view.alpha >= _COVERED)))
        progress("render", index + 1, len(cameras))


def contact_sheet(views: Sequence[UInt8Array], columns: int = 3, width: int = _SHEET_WIDTH) -> UInt8Array:
    """Several views of one size in rows, [H', W', 3]; scaled down, if need be, to at most ``width`` pixels across.

    Missing cells of the last row are white.
    """
    from PIL import Image

    columns = min(columns, len(views))
    height, across = views[0].shape[:2]
    scale = min(1.0, width / (across * columns))
    size = max(1, round(across * scale)), max(1, round(height * scale))
    tiles = [np.asarray(Image.fromarray(view).resize(size, Image.Resampling.BOX)) for view in views]
    tiles += [np.full_like(tiles[0], 255)] * (-len(tiles) % columns)
    rows = [np.concatenate(tiles[i : i + columns], axis=1) for i in range(0, len(tiles), columns)]
    return np.concatenate(rows, axis=0)


def write_preview(
    scene: Scene,
    cameras: Sequence[Camera],
    video: Path,
    picture: Path | None = None,
    fps: float = 20.0,
    device: str = "cpu",
    progress: Progress = _silent,
) -> float:
    """Render ``cameras`` once, into an H.264 video and, if asked for, one picture of six evenly spaced views.

    Returns:
        The share of all pixels that are holes: nothing of the scene covers half of them.

    Raises:
        BadInput: no cameras, cameras of different sizes, or paths that cannot be written.
    """
    wanted = set(np.linspace(0, len(cameras) - 1, min(_SHEET_VIEWS, len(cameras))).round().astype(int).tolist())
    kept: list[UInt8Array] = []
    holes: list[float] = []

    def watched() -> Iterator[UInt8Array]:
        for index, (frame, open_share) in enumerate(_rendered(scene, cameras, device, progress)):
            holes.append(open_share)
            if index in wanted:
                kept.append(frame)
            yield frame

    write_video(video, watched(), fps)
    if picture is not None:
        save_image(picture, contact_sheet(kept))
    return float(np.mean(holes))
