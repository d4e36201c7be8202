"""Frames that somebody rendered elsewhere, with the cameras they were rendered from: folders of images, or mp4."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.adapters.adapter import MethodOutput, RunOptions
from bench.adapters.camera_match import frames_of_case, input_frame
from bench.adapters.external import ExternalSpec
from bench.adapters.sources import fingerprint, scene_file
from bench.adapters.video_facts import video_facts
from bench.cameras_io import NamedCamera, find_camera_file, natural_key, read_camera_file
from bench.datasets.case import SceneCase
from orca.conventions import UInt8Array
from orca.errors import BadInput, Unavailable
from orca.images import load_image
from orca.video import read_video

__all__ = ["IMAGE_SUFFIXES", "FrameFolders", "Videos", "frame_files", "open_frames", "open_video", "video_cameras"]

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg")
MAX_FRAMES = 100_000


def open_frames(spec: ExternalSpec) -> FrameFolders:
    """The factory of kind ``frames``."""
    spec.no_options()
    return FrameFolders(spec.name, spec.path)


def open_video(spec: ExternalSpec) -> Videos:
    """The factory of kind ``video``."""
    spec.no_options()
    return Videos(spec.name, spec.path)


@dataclass(frozen=True)
class FrameFolders:
    """``PATH/<scene>/``: one image a camera, and a camera file (`bench.cameras_io`).

    Images are taken in natural order (2 before 10); where the camera file names images, by those names.
    """

    name: str
    path: Path

    def version(self, options: RunOptions) -> str:
        """Changes when any file of the folder does."""
        return f"frames of {self.path}, {fingerprint(self.path)}; reader 1"

    def run(self, case: SceneCase, options: RunOptions) -> MethodOutput:
        """Read the evaluated frames.

        Raises:
            Unavailable: no folder for the scene, no images or no camera file in it.
            BadInput: other views than the case's, a missing or unreadable image, or images of different sizes.
        """
        folder = self.path / case.name
        files, cameras = frame_files(folder)
        wanted = frames_of_case(case, [named.camera for named in cameras], str(folder))
        first = input_frame(case, len(cameras))
        images: list[UInt8Array] = []
        for done, index in enumerate(wanted, start=1):
            images.append(_sized(files[index], images))
            options.progress("read", done, len(wanted))
        view = None if first is None else _sized(files[first], images)
        return MethodOutput(np.stack(images), input_view=view, notes=_notes(case, images[0], "read from image files"))


def frame_files(folder: Path) -> tuple[tuple[Path, ...], tuple[NamedCamera, ...]]:
    """The images of a scene's folder, one for each camera, and the cameras.

    Raises:
        Unavailable: no such folder, no images, or no camera file.
        BadInput: a camera without its image, or another number of images than of cameras.
    """
    if not folder.is_dir():
        raise Unavailable(f"no folder {folder}", "a folder of frames named after the scene", "put it there")
    images = sorted(
        (p for p in folder.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES and p.is_file() and p.name[0] != "."),
        key=lambda p: natural_key(p.name),
    )
    if not 0 < len(images) <= MAX_FRAMES:
        raise Unavailable(f"{len(images)} images in {folder}", f"1 to {MAX_FRAMES}, .png or .jpg", "put frames there")
    cameras = _cameras(find_camera_file(folder), folder)
    if all(named.image for named in cameras):
        here = {image.name: image for image in images}
        missing = [named.image for named in cameras if named.image not in here]
        if missing:
            raise BadInput(
                f"{folder}: no image {missing[0]} ({len(missing)} of {len(cameras)} missing)",
                "an image for every camera",
                "render it, or take the camera out of the camera file",
            )
        images = [here[named.image] for named in cameras]
    if len(images) != len(cameras):
        raise BadInput(
            f"{folder}: {len(images)} images and {len(cameras)} cameras", "one image a camera", "remove what is extra"
        )
    return tuple(images), cameras


def _cameras(file: Path | None, where: Path) -> tuple[NamedCamera, ...]:
    if file is None:
        raise Unavailable(
            f"no camera file beside the frames in {where}",
            "cameras.json, transforms.json, or cameras.txt and images.txt",
            "copy the one that `bench cameras` wrote for this scene",
        )
    return read_camera_file(file)


def _sized(path: Path, before: Sequence[UInt8Array]) -> UInt8Array:
    image = load_image(path)
    if before and image.shape != before[0].shape:
        raise BadInput(
            f"{path} is {image.shape[1]}x{image.shape[0]}, the frames before it {before[0].shape[1]}x"
            f"{before[0].shape[0]}",
            "frames of one size",
            "render them at one size",
        )
    return image


@dataclass(frozen=True)
class Videos:
    """``PATH/<scene>.mp4`` with ``PATH/<scene>.json``, or ``PATH/<scene>/`` with one mp4 and a camera file."""

    name: str
    path: Path

    def version(self, options: RunOptions) -> str:
        """Changes when any file of the folder does."""
        return f"videos of {self.path}, {fingerprint(self.path)}; reader 1"

    def run(self, case: SceneCase, options: RunOptions) -> MethodOutput:
        """Decode the evaluated frames. Raises `Unavailable` or `BadInput` as `FrameFolders.run`."""
        video = scene_file(self.path, case.name, ".mp4", "video")
        cameras, facts = [named.camera for named in video_cameras(video)], video_facts(video)
        if facts.frames != len(cameras):
            raise BadInput(
                f"{video}: {facts.frames} frames and {len(cameras)} cameras", "one frame a camera", "write both again"
            )
        wanted = frames_of_case(case, cameras, str(video))
        first = input_frame(case, len(cameras))
        options.progress("decode", 0, 1)
        frames = read_video(video, (*wanted, wanted[0] if first is None else first))
        options.progress("decode", 1, 1)
        notes = _notes(case, frames[0], "decoded from a video")
        return MethodOutput(frames[:-1], input_view=None if first is None else frames[-1], notes=notes)


def video_cameras(video: Path) -> tuple[NamedCamera, ...]:
    """The cameras of a video: the .json of its name, else the camera file of its folder if that is all it holds."""
    beside = video.with_suffix(".json")
    if beside.is_file():
        return read_camera_file(beside)
    alone = len(list(video.parent.glob("*.mp4"))) == 1
    return _cameras(find_camera_file(video.parent) if alone else None, video)


def _notes(case: SceneCase, frame: UInt8Array, how: str) -> tuple[str, ...]:
    size, own = (frame.shape[1], frame.shape[0]), (case.camera.width, case.camera.height)
    note = f"{how}, not timed here"
    return (note,) if size == own else (note, f"given at {size[0]}x{size[1]}; the case is {own[0]}x{own[1]}")
