"""VistaDream's published videos as a method: the frames are read, nothing is rendered."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from bench.adapters.adapter import MethodOutput, RunOptions
from bench.datasets import SceneCase, resolve_data_root
from bench.datasets.realmdreamer import RealmDreamer
from bench.trajectories import first_difference
from orca.errors import BadInput, Unavailable
from orca.video import read_video

__all__ = ["VISTADREAM", "VISTADREAM_COARSE", "PublishedVideos"]


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
        return MethodOutput(frames=frames[1:], input_view=frames[0], notes=tuple(notes))


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


VISTADREAM = PublishedVideos("vistadream", "rgb")
VISTADREAM_COARSE = PublishedVideos("vistadream-coarse", "coarse")
