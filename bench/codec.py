"""Every method's frames through the video codec that VistaDream's published frames went through."""

from __future__ import annotations

import io
from dataclasses import replace
from fractions import Fraction

import numpy as np

from bench.adapters.adapter import MethodOutput
from orca.conventions import UInt8Array
from orca.errors import BadInput

__all__ = ["ALREADY_CODED", "CODEC", "coded_before", "coded_output", "through_codec"]

# Read from the encoder's own note inside all 22 published files: x264 at its defaults (preset medium), crf 23,
# yuv420p, 20 fps, a key frame at least every 250. One thread, so that the pixels do not depend on the machine's cores.
CODEC = "H.264 crf 23, x264 preset medium, yuv420p, 20 fps, 1 thread"
ALREADY_CODED = "decoded from an H.264 video, not coded again"
_CRF, _FPS = "23", Fraction(20)


def coded_before(method_version: str) -> bool:
    """True if the method's frames came out of such a video: an adapter says so by "H.264" in its version."""
    return "H.264" in method_version


def coded_output(output: MethodOutput) -> MethodOutput:
    """The output with all of its pictures encoded and decoded; coverage is no picture and stays.

    The input view leads the clip of the frames, as it does in the published videos (their frame 0); where it has
    another size it is a clip of its own, and so is each true view, which is no neighbour of any frame.
    """
    view, frames = output.input_view, output.frames
    if view is not None and view.shape == frames.shape[1:]:
        clip = through_codec(np.concatenate([view[None], frames]))
        view, frames = clip[0], clip[1:]
    else:
        frames = through_codec(frames)
        view = None if view is None else through_codec(view[None])[0]
    truth = output.true_views
    return replace(
        output,
        frames=frames,
        input_view=view,
        true_views=None if truth is None else tuple(through_codec(image[None])[0] for image in truth),
    )


def through_codec(frames: UInt8Array) -> UInt8Array:
    """Encode a clip and decode it again, [n, H, W, 3] uint8 to the same shape.

    Odd sizes, which 4:2:0 colour cannot hold, get one more row or column for the passage.

    Raises:
        BadInput: no frames, or not [n, H, W, 3] uint8.
    """
    if frames.ndim != 4 or frames.shape[3] != 3 or frames.dtype != np.uint8 or not frames.size:
        raise BadInput(f"a clip of shape {frames.shape}, {frames.dtype}", "uint8 [n, H, W, 3], n >= 1", "check it")
    height, width = frames.shape[1:3]
    even = np.pad(frames, ((0, 0), (0, height % 2), (0, width % 2), (0, 0)), mode="edge")
    decoded = _decode(_encode(even))
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


def _decode(stream: bytes) -> UInt8Array:
    """As `orca.video.read_video` decodes the published files, so that both sides lose the same there."""
    import av

    with av.open(io.BytesIO(stream)) as container:
        return np.stack([frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)])
