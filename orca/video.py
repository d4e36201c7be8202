"""H.264 video files in and out."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from orca.atomic import atomic_path
from orca.conventions import UInt8Array
from orca.errors import BadInput

__all__ = ["MAX_PIXELS", "SAFE_OPTIONS", "read_video", "write_video"]

# Playlists are left out (HLS, DASH, concat, image sequences): they make the decoder open other files and addresses.
SAFE_OPTIONS = {
    "protocol_whitelist": "file",
    "format_whitelist": "mov,matroska,avi,h264,hevc,av1,mpegts,mpeg,gif,yuv4mpegpipe,wav",
}
MAX_PIXELS = 100_000_000  # of a frame
MAX_BYTES = 8 * 2**30  # of all frames that are kept


def write_video(
    path: Path, frames: Iterable[UInt8Array], fps: float = 20.0, crf: int = 23, key_every: int | None = None
) -> None:
    """Write an mp4: H.264, yuv420p.

    The file appears only when it is complete. H.264 with 4:2:0 colour needs even sizes: an odd width or height gets
    one more column or row, a copy of the last; who reads it back cuts it off (``frames[:, :height, :width]``).

    Args:
        path: where to write; folders are made.
        frames: images of one size, [H, W, 3] uint8; consumed one at a time.
        fps: frames a second.
        crf: constant rate factor, 0 (lossless luma) to 51.
        key_every: frames from one key frame to the next, for players that jump about; the encoder's choice if None.

    Raises:
        BadInput: no frames, frames of different sizes, another type, or fps/crf/key_every out of range.
    """
    if not (0 < fps <= 1000 and 0 <= crf <= 51):
        raise BadInput(f"fps {fps:g}, crf {crf}", "0 < fps <= 1000 and crf 0..51", "give other values")
    if key_every is not None and key_every < 1:
        raise BadInput(f"a key frame every {key_every} frames", "1 or more", "leave it out")
    with atomic_path(Path(path)) as unfinished:
        _encode(unfinished, _even(_checked(frames)), fps, crf, key_every)


def _checked(frames: Iterable[UInt8Array]) -> Iterator[UInt8Array]:
    first: tuple[int, ...] | None = None
    for frame in frames:
        image = np.asarray(frame)
        first = first or image.shape
        if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3 or image.shape != first:
            raise BadInput(
                f"a video frame of shape {image.shape}, {image.dtype}, after a first one of {first}",
                "uint8 frames [H, W, 3], all of one size",
                "convert them with orca.conventions.to_uint8",
            )
        yield image
    if first is None:
        raise BadInput("a video of no frames", "one frame or more", "check what was rendered")


def _even(frames: Iterator[UInt8Array]) -> Iterator[UInt8Array]:
    for frame in frames:
        odd = frame.shape[0] % 2, frame.shape[1] % 2
        yield np.pad(frame, ((0, odd[0]), (0, odd[1]), (0, 0)), mode="edge") if any(odd) else frame


def _encode(path: Path, frames: Iterator[UInt8Array], fps: float, crf: int, key_every: int | None) -> None:
    import av

    first = next(frames)
    with av.open(str(path), "w", format="mp4", options={"movflags": "+faststart"}) as container:
        stream = container.add_stream("libx264", rate=Fraction(fps).limit_denominator(1000))
        stream.height, stream.width = first.shape[:2]
        stream.pix_fmt = "yuv420p"
        stream.options = {"crf": str(crf), **({} if key_every is None else {"g": str(key_every)})}
        container.mux(stream.encode(av.VideoFrame.from_ndarray(first, format="rgb24")))
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format="rgb24")))
        container.mux(stream.encode(None))


def read_video(path: Path, indices: Sequence[int] | None = None) -> UInt8Array:
    """Decode a video from its beginning and keep the frames asked for, [n, H, W, 3] uint8.

    Args:
        path: any file the decoder reads.
        indices: frame numbers in any order, repeats allowed; all frames when left out. Decoding stops at the largest.

    Raises:
        BadInput: no such file, not a video, damaged, without frames, or an index outside it.
    """
    wanted = None if indices is None else [int(i) for i in indices]
    if wanted is not None and (not wanted or min(wanted) < 0):
        raise BadInput(f"frame indices {wanted[:5]}", "one index or more, none negative", "check the trajectory")
    kept, count = _decode(Path(path), None if wanted is None else set(wanted))
    order = range(count) if wanted is None else wanted
    missing = [i for i in order if i not in kept]
    if missing or not kept:
        raise BadInput(
            f"{path} has {count} frames; frame {missing[0] if missing else 0} was asked for",
            "indices from 0 to the number of frames less one",
            "check that the video is complete and belongs to this trajectory",
        )
    return np.stack([kept[i] for i in order])


def _decode(path: Path, wanted: set[int] | None) -> tuple[dict[int, UInt8Array], int]:
    """Frames by index, and how many were seen before it could stop."""
    import av

    if not path.is_file():
        raise BadInput(f"no such video: {path}", "a video file", "check the path")
    kept: dict[int, UInt8Array] = {}
    size: tuple[int, int] | None = None
    last = None if wanted is None else max(wanted)
    count = 0
    try:
        with av.open(str(path), options=SAFE_OPTIONS) as container:
            for frame in container.decode(_video_stream(container, path)):
                size = size or (frame.width, frame.height)
                if (frame.width, frame.height) != size:
                    raise _unreadable(path, f"frame {count} is {frame.width}x{frame.height}, the first {size}")
                if wanted is None or count in wanted:
                    kept[count] = frame.to_ndarray(format="rgb24")
                if len(kept) * 3 * size[0] * size[1] > MAX_BYTES:
                    raise _unreadable(path, f"more than {MAX_BYTES >> 30} GiB of frames")
                count += 1
                if last is not None and count > last:
                    break
    except BadInput:
        raise
    except (av.FFmpegError, OSError, ValueError, MemoryError) as error:  # PyAV's own, and what it raises on nonsense
        raise _unreadable(path, str(error)) from error
    return kept, count


def _video_stream(container: Any, path: Path) -> Any:
    if not container.streams.video:
        raise _unreadable(path, "it has no video stream")
    stream = container.streams.video[0]
    if stream.codec_context is None:
        raise _unreadable(path, "no decoder knows its codec")
    width, height = stream.codec_context.width, stream.codec_context.height
    if not 0 < width * height <= MAX_PIXELS:
        raise _unreadable(path, f"frames of {width}x{height} pixels")
    stream.thread_type = "AUTO"
    return stream


def _unreadable(path: Path, why: str) -> BadInput:
    return BadInput(f"unreadable video {path}: {why}", "a complete H.264 mp4, or what ffmpeg reads", "fetch it again")
