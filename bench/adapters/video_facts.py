"""What a video holds, told from its packets: nothing is decoded, so it costs little and cannot be a bomb."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from orca.errors import BadInput
from orca.video import SAFE_OPTIONS

__all__ = ["VideoFacts", "video_facts"]

MAX_FRAMES = 1_000_000
MAX_PIXELS = 100_000_000


@dataclass(frozen=True)
class VideoFacts:
    """Frames, and their size in pixels as the container says."""

    frames: int
    width: int
    height: int


def video_facts(path: Path) -> VideoFacts:
    """Count the frames of a video.

    Raises:
        BadInput: no such file, not a video, without frames, or of a size or length that no method renders.
    """
    import av

    if not path.is_file():
        raise BadInput(f"no such video: {path}", "a video file", "check the path")
    try:
        with av.open(str(path), options=SAFE_OPTIONS) as container:
            if not container.streams.video:
                raise BadInput(f"{path} has no video stream", "an mp4 with one", "check the file")
            stream = container.streams.video[0]
            if stream.codec_context is None:
                raise BadInput(f"{path} of a codec that no decoder knows", "H.264 in an mp4", "encode it again")
            width, height = int(stream.codec_context.width), int(stream.codec_context.height)
            count = 0
            for packet in container.demux(stream):
                count += bool(packet.size)
                if count > MAX_FRAMES:
                    break
    except (av.FFmpegError, OSError, ValueError, MemoryError) as error:
        if isinstance(error, BadInput):
            raise
        raise BadInput(f"unreadable video {path}: {error}", "a complete mp4", "fetch it again") from error
    if not (0 < count <= MAX_FRAMES and 0 < width * height <= MAX_PIXELS):
        raise BadInput(
            f"{path}: {count} frames of {width}x{height}",
            f"1 to {MAX_FRAMES} frames of at most {MAX_PIXELS // 10**6} megapixels",
            "check the file",
        )
    return VideoFacts(count, width, height)
