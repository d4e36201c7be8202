"""Every method's frames through the video codec that VistaDream's published frames went through."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction

import numpy as np

from bench.adapters.adapter import MethodOutput
from orca.conventions import UInt8Array
from orca.errors import BadInput

__all__ = ["ALREADY_CODED", "CODEC", "coded_output", "holding", "through_codec"]

# Read from the encoder's own note inside all 22 published files: x264 at its defaults (preset medium), crf 23,
# yuv420p, 20 fps, a key frame at least every 250. One thread, so that the pixels do not depend on the machine's cores.
#
# Published clips hold the whole path (250 frames), ours the evaluated frames only (50), with five times the motion
# between neighbours: the same settings then cost 2.8-3.9 dB more (measured on the published frames themselves). So each
# frame is held for as many frames as the path has up to the next evaluated one, which leaves 0.7-1.2 dB of that.
CODEC = "H.264 crf 23, x264 preset medium, yuv420p, 20 fps, 1 thread, evaluated frames held up to the next one"
ALREADY_CODED = "decoded from an H.264 video, not coded again"
_CRF, _FPS = "23", Fraction(20)
# x264 core 165 does not repeat itself where a row has no multiple of 8 macro-blocks: of 200 codings of one clip 1 came
# out otherwise at 64 columns, 11 at 80, 15 at 96, 40 at 144, and none of 500 at 128.
_COLUMNS = 128


def holding(eval_indices: Sequence[int]) -> int:
    """How many frames the path has from one evaluated frame to the next: the median step, 1 at least."""
    steps = np.abs(np.diff(np.asarray(eval_indices, np.int64)))
    return max(1, int(np.median(steps))) if len(steps) else 1


def coded_output(output: MethodOutput, hold: int = 1) -> MethodOutput:
    """The output with all of its pictures encoded and decoded; coverage is no picture and stays.

    The input view leads the clip of the frames, as it does in the published videos (their frame 0); where it has
    another size it is a clip of its own, and so is each true view, which is no neighbour of any frame.

    Args:
        output: what a method returned.
        hold: how often each picture of the clip is shown, see `holding`.
    """
    view, frames = output.input_view, output.frames
    if view is not None and view.shape == frames.shape[1:]:
        clip = through_codec(np.concatenate([view[None], frames]), hold)
        view, frames = clip[0], clip[1:]
    else:
        frames = through_codec(frames, hold)
        view = None if view is None else through_codec(view[None], hold)[0]
    truth = output.true_views
    return replace(
        output,
        frames=frames,
        input_view=view,
        true_views=None if truth is None else tuple(through_codec(image[None], hold)[0] for image in truth),
    )


def through_codec(frames: UInt8Array, hold: int = 1) -> UInt8Array:
    """Encode a clip and decode it again, [n, H, W, 3] uint8 to the same shape; each frame is shown ``hold`` times.

    For the passage frames get an even height and a width that is a multiple of `_COLUMNS`, by copies of the rim.

    Raises:
        BadInput: no frames, or not [n, H, W, 3] uint8.
    """
    if frames.ndim != 4 or frames.shape[3] != 3 or frames.dtype != np.uint8 or not frames.size:
        raise BadInput(f"a clip of shape {frames.shape}, {frames.dtype}", "uint8 [n, H, W, 3], n >= 1", "check it")
    height, width = frames.shape[1:3]
    even = np.pad(frames, ((0, 0), (0, height % 2), (0, -width % _COLUMNS), (0, 0)), mode="edge")
    decoded = _decode(_encode(np.repeat(even, hold, axis=0)), hold)
    if decoded.shape != even.shape:
        raise RuntimeError(f"{even.shape} went into the codec, {decoded.shape} came out")
    return np.ascontiguousarray(decoded[:, :height, :width])


def _encode(frames: UInt8Array) -> bytes:
    import av

    file = io.BytesIO()
    with av.open(file, "w", format="matroska") as container:
        stream = container.add_stream("libx264", rate=_FPS)
        stream.height, stream.width = frames.shape[1:3]
        stream.pix_fmt = "yuv420p"
        stream.codec_context.thread_count = 1
        stream.options = {"crf": _CRF, "preset": "medium"}
        for frame in frames:
            picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format="rgb24")
            container.mux(stream.encode(picture.reformat(format="yuv420p", interpolation="BICUBIC")))
        container.mux(stream.encode(None))
    return file.getvalue()


def _decode(stream: bytes, hold: int) -> UInt8Array:
    """The middle one of each frame's showings.

    Decoded as `orca.video.read_video` decodes the published files, so that both sides lose the same there.
    """
    import av

    with av.open(io.BytesIO(stream)) as container:
        shown = enumerate(container.decode(video=0))
        return np.stack([frame.to_ndarray(format="rgb24") for i, frame in shown if i % hold == hold // 2])
