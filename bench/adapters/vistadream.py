"""VistaDream's videos as methods: the frames are read, nothing is rendered.

A VistaDream run renders with the shorter side at 512 pixels at most, and its video writer then stretches the frames to
multiples of 16: `unstretched` undoes that. A video carries no cameras; they are taken to be those of VistaDream's path.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from bench.adapters.adapter import MethodOutput, RunOptions
from bench.adapters.external import ExternalSpec
from bench.adapters.sources import fingerprint, one_of
from bench.adapters.video_facts import video_facts
from bench.datasets import SceneCase, resolve_data_root
from bench.datasets.realmdreamer import RealmDreamer
from bench.trajectories import first_difference
from orca.conventions import UInt8Array
from orca.errors import BadInput, Unavailable
from orca.video import read_video

__all__ = [
    "VIDEO_NAMES",
    "VISTADREAM",
    "VISTADREAM_COARSE",
    "PublishedVideos",
    "RunVideos",
    "open_run_videos",
    "unstretched",
]

MACRO_BLOCK = 16
RENDER_SIDE = 512  # of the shorter side, at most

# Per stage, the names that the two published generations of VistaDream's code write, and the published layout.
VIDEO_NAMES = {
    "refine": ("{scene}/refine.video_rgb.mp4", "{scene}/video_rgb.mp4", "rgb/{scene}.mp4", "{scene}.mp4"),
    "coarse": ("{scene}/coarse.video_rgb.mp4", "coarse/{scene}.mp4"),
}


@dataclass(frozen=True)
class PublishedVideos:
    """Reads ``<data_root>/vistadream/<folder>/<scene>.mp4``.

    Frames keep the size of the video, which is 480x480 for bust: a metric that compares them with an image of the case
    resizes them (the note says so). The cameras are in pixels of the case; `Camera.resized` scales them.

    Attributes:
        name: the method's name.
        folder: "rgb" (refined) or "coarse" (before refinement).
    """

    name: str
    folder: str

    def version(self, options: RunOptions) -> str:
        """The videos are fixed; nothing of ``options`` changes them."""
        return f"published videos, {self.folder}, H.264 crf 23; reader 1"

    def run(self, case: SceneCase, options: RunOptions) -> MethodOutput:
        """The video's frames at ``case.eval_indices``; ``input_view`` is its frame 0.

        Raises:
            BadInput: a case that VistaDream published no video of, or other cameras than the video's.
            Unavailable: the video is not in the data root.
        """
        root = resolve_data_root(options.data_root)
        _check_cameras(case, root)
        path = root / "vistadream" / self.folder / f"{case.name}.mp4"
        if not path.is_file():
            raise Unavailable(
                f"VistaDream's published video {path} is not here",
                f"{case.name}.mp4 under {path.parent}",
                "put it there, or name another folder with --data-root or ORCA_DATA_ROOT",
            )
        options.progress("decode", 0, 1)
        frames = read_video(path, (0, *case.eval_indices))
        options.progress("decode", 1, 1)
        height, width = frames.shape[1:3]
        notes = ["decoded from H.264 crf 23, published, not timed here"]
        if (width, height) != (case.camera.width, case.camera.height):
            notes.append(
                f"published at {width}x{height}, kept so; the case is {case.camera.width}x{case.camera.height}"
            )
        return MethodOutput(frames=frames[1:], input_view=frames[0], notes=tuple(notes), coded=True)


def _check_cameras(case: SceneCase, root: Path) -> None:
    """Frames may only be compared at the cameras that they were rendered from."""
    if case.dataset != RealmDreamer.name:
        raise BadInput(
            f"VistaDream on the data set '{case.dataset}'",
            "data set realmdreamer: only of that did VistaDream publish frames",
            "leave this method out, or use --dataset realmdreamer",
        )
    published = RealmDreamer(root).published_trajectory(case.name, case.camera)
    frame = first_difference(case.trajectory, published)
    if frame is not None:
        raise BadInput(
            f"trajectory '{case.trajectory.name}' of {len(case.trajectory)} frames differs from the published one "
            f"at frame {frame}",
            f"trajectory vistadream, {len(published)} frames",
            "leave out --trajectory, or leave this method out",
        )


def open_run_videos(spec: ExternalSpec) -> RunVideos:
    """The factory of kind ``vistadream-video``; option ``stage``: refine or coarse."""
    return RunVideos(spec.name, spec.path, spec.choice("stage", ("refine", "coarse"), "refine"))


@dataclass(frozen=True)
class RunVideos:
    """The videos of VistaDream runs of one's own, by the names of `VIDEO_NAMES`.

    Attributes:
        name: the row's name.
        path: folder with a folder for each scene.
        stage: "refine" or "coarse".
    """

    name: str
    path: Path
    stage: str

    def version(self, options: RunOptions) -> str:
        """Changes when any file of the folder does."""
        return f"VistaDream videos of {self.path}, {self.stage}, {fingerprint(self.path)}; reader 1"

    def run(self, case: SceneCase, options: RunOptions) -> MethodOutput:
        """The video's frames at ``case.eval_indices``, macro-block stretch undone; ``input_view`` is its frame 0.

        Raises:
            BadInput: the case's path is not VistaDream's, or a video of another size or number of frames.
            Unavailable: no video of the scene.
        """
        if case.dataset == RealmDreamer.name:
            _check_cameras(case, resolve_data_root(options.data_root))
        elif case.trajectory.name != "vistadream":
            raise BadInput(
                f"a VistaDream video along trajectory '{case.trajectory.name}'",
                "trajectory vistadream: a video carries no cameras, and that is the path VistaDream renders",
                "use --trajectory vistadream, or bring the cameras: video:PATH",
            )
        video = one_of(self.path, case.name, VIDEO_NAMES[self.stage], f"{self.stage} video of VistaDream")
        options.progress("decode", 0, 1)
        count, facts = len(case.trajectory), video_facts(video)
        if facts.frames != count:
            raise BadInput(f"{video} has {facts.frames} frames", f"{count}, as the path", "render along this path")
        decoded = read_video(video, (0, *case.eval_indices))
        frames = unstretched(decoded, case.camera.width, case.camera.height, str(video))
        options.progress("decode", 1, 1)
        notes = ["decoded from a VistaDream run's H.264, cameras by its closed form, not timed here"]
        if frames.shape != decoded.shape:
            notes.append(f"stretched to multiples of {MACRO_BLOCK} by the writer; undone")
        return MethodOutput(frames=frames[1:], input_view=frames[0], notes=tuple(notes), coded=True)


def unstretched(frames: UInt8Array, width: int, height: int, where: str) -> UInt8Array:
    """Frames [n, h, w, 3] at the size that VistaDream rendered an image of ``width`` x ``height`` at.

    Lanczos undoes a bicubic stretch of 12 rows in 500 to 44-52 dB, area or bilinear resizing to 39-47 dB.

    Raises:
        BadInput: a size that is neither that one, nor that one stretched to multiples of 16, nor of its shape.
    """
    given = frames.shape[2], frames.shape[1]
    scale = min(1.0, RENDER_SIDE / min(width, height))
    rendered = int(width * scale), int(height * scale)
    if given == rendered or given[0] * height == given[1] * width:
        return frames
    if given != tuple(-(-side // MACRO_BLOCK) * MACRO_BLOCK for side in rendered):
        raise BadInput(
            f"{where} of {given[0]}x{given[1]} pixels for an image of {width}x{height}",
            f"{rendered[0]}x{rendered[1]}, or the next multiples of {MACRO_BLOCK}, or another size of that shape",
            "check that the video belongs to this scene",
        )
    return np.stack([cv2.resize(frame, rendered, interpolation=cv2.INTER_LANCZOS4) for frame in frames]).astype(
        np.uint8
    )


VISTADREAM = PublishedVideos("vistadream", "rgb")
VISTADREAM_COARSE = PublishedVideos("vistadream-coarse", "coarse")
