"""Depth from any single-input ONNX network, run by OpenCV."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from orca.camera import Camera
from orca.conventions import Float32Array
from orca.errors import BadInput, Unavailable
from orca.priors.depth import FAR_RATIO, DepthEstimate, clip_outliers, inverse_to_depth
from orca.priors.spec import PriorSpec

__all__ = ["OnnxDepth"]

TRIAL_S = 600
MAX_BYTES = 2**31 - 1  # protobuf's own limit
_IMAGENET_MEAN = np.array([0.485, 0.456, 0.406], np.float32)
_IMAGENET_STD = np.array([0.229, 0.224, 0.225], np.float32)


@dataclass(frozen=True)
class OnnxDepth:
    """``onnx:NET.onnx?size=384&range=255&meaning=inverse_depth``: a network with one image in and one map out.

    Attributes:
        path: the network.
        width, height: the network's input size (option ``size``: ``384`` or ``WIDTHxHEIGHT``); the image is stretched
            to it by area, and the map back to the image bilinearly.
        value_range: ``1`` for [0, 1], ``255`` for [0, 255], ``imagenet`` for [0, 1] less the ImageNet mean over its
            deviation (option ``range``).
        meaning: of the output. ``inverse_depth``: relative, larger is nearer; the far end is bounded at
            ``far`` times the median depth, so that a sky of exactly 0 is far and finite. ``depth``: z-depth.
        bgr: channels in reverse order (option ``order=bgr``).
        far: see ``inverse_depth``.
        metric: proportional to true depth; by default only for ``meaning=depth``.
        hfov_deg: the horizontal field of view, if known (option ``hfov``).

    A relative depth is scaled to a median of 1.
    """

    path: Path
    width: int
    height: int
    value_range: str = "1"
    meaning: str = "inverse_depth"
    bgr: bool = False
    far: float = FAR_RATIO
    metric: bool | None = None
    hfov_deg: float | None = None
    name: str = "onnx"

    @classmethod
    def from_spec(cls, spec: PriorSpec) -> OnnxDepth:
        """Read the options; ``size``, ``range`` and ``meaning`` must be declared: nothing in the file says them."""
        spec.allow("size", "range", "meaning", "order", "far", "metric", "hfov")
        for key, example in (("size", "384"), ("range", "255"), ("meaning", "inverse_depth")):
            if key not in spec.options:
                raise BadInput(f"'onnx' without {key}", "size, range and meaning", f"add for example {key}={example}")
        width, height = _parse_size(spec.options["size"])
        return cls(
            path=spec.need_path(),
            width=width,
            height=height,
            value_range=spec.choice("range", ("1", "255", "imagenet"), "1"),
            meaning=spec.choice("meaning", ("inverse_depth", "depth"), "inverse_depth"),
            bgr=spec.choice("order", ("rgb", "bgr"), "rgb") == "bgr",
            far=spec.number("far", FAR_RATIO),
            metric=spec.flag("metric", True) if "metric" in spec.options else None,
            hfov_deg=spec.optional_number("hfov"),
        )

    def estimate(self, image: Float32Array, camera: Camera) -> DepthEstimate:
        """See `DepthProvider`. A missing network is `Unavailable`; one that cannot run like this is `BadInput`."""
        output = self._run(self._blob(image))
        resized = cv2.resize(output, (image.shape[1], image.shape[0]), interpolation=cv2.INTER_LINEAR)
        metric = self.meaning == "depth" if self.metric is None else self.metric
        notes: tuple[str, ...] = ()
        if self.meaning == "inverse_depth":
            depth = inverse_to_depth(clip_outliers(np.maximum(resized, 0.0)), self.far)
            notes = (f"relative inverse depth; farther than {self.far:g} times the median depth is set to that",)
        else:
            depth = np.asarray(resized, np.float32)
        if not metric and bool(np.median(depth) > 0):
            depth = depth / np.median(depth)
        return DepthEstimate(depth, f"onnx {self.path.name}", metric, self.hfov_deg, notes)

    def _blob(self, image: Float32Array) -> Float32Array:
        """The network's input, [1, 3, height, width]."""
        shrinks = image.shape[0] >= self.height and image.shape[1] >= self.width
        interpolation = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
        small = cv2.resize(np.asarray(image, np.float32), (self.width, self.height), interpolation=interpolation)
        if self.value_range == "255":
            small = small * 255.0
        elif self.value_range == "imagenet":
            small = (small - _IMAGENET_MEAN) / _IMAGENET_STD
        ordered = small[..., ::-1] if self.bgr else small
        return np.ascontiguousarray(ordered.transpose(2, 0, 1)[None], np.float32)

    def _run(self, blob: Float32Array) -> Float32Array:
        """The output map, [h, w], finite."""
        net = self._load()
        try:
            net.setInput(blob)
            output = np.asarray(net.forward(), np.float32)
        except cv2.error as error:
            raise BadInput(
                f"network '{self.path.name}' does not run on an image of {self.width}x{self.height} ({error.err})",
                "a network with one image input and one map output",
                "declare its true input size",
            ) from error
        squeezed = np.squeeze(output)
        if squeezed.ndim != 2 or not np.isfinite(squeezed).all():
            raise BadInput(
                f"network '{self.path.name}' returned shape {output.shape}, finite: {bool(np.isfinite(output).all())}",
                "one finite map",
                "declare its true input size and range, or use another network",
            )
        return np.ascontiguousarray(squeezed)

    def _load(self) -> Any:
        if not self.path.is_file():
            raise Unavailable(
                f"network '{self.path}' does not exist", "an ONNX file", "put it there, or correct the path"
            )
        if (size := self.path.stat().st_size) > MAX_BYTES:
            raise BadInput(f"network '{self.path}' of {size} bytes", f"at most {MAX_BYTES} bytes", "use a smaller one")
        facts = self.path.stat()
        _check_by_trial(self.path, self.width, self.height, facts.st_size, facts.st_mtime_ns)
        try:
            return cv2.dnn.readNetFromONNX(str(self.path))
        except cv2.error as error:
            raise BadInput(
                f"'{self.path}' is not an ONNX network that OpenCV {cv2.__version__} reads ({error.err})",
                "an ONNX file",
                "export the network again, with a fixed input size",
            ) from error


# What a child process does with a network before this one does: read it, and run it once on nothing.
_TRIAL = """
import sys
import cv2
import numpy as np
try:
    net = cv2.dnn.readNetFromONNX(sys.argv[1])
    net.setInput(np.zeros((1, 3, int(sys.argv[3]), int(sys.argv[2])), np.float32))
    net.forward()
except cv2.error:
    pass  # the parent meets the same error, and says more about it
"""


@lru_cache(maxsize=16)
def _check_by_trial(path: Path, width: int, height: int, size: int, modified_ns: int) -> None:
    """Raise `BadInput` for a network that crashes or hangs OpenCV, which some malformed ones do.

    Tried once for each state of a file (``size``, ``modified_ns``) and input size.
    """
    command = [sys.executable, "-I", "-c", _TRIAL, str(path.absolute()), str(width), str(height)]
    try:
        code = subprocess.run(command, capture_output=True, timeout=TRIAL_S, check=False).returncode
    except subprocess.TimeoutExpired as error:
        raise BadInput(
            f"network '{path}' is not done with one image after {TRIAL_S} s", "a network that ends", "use another"
        ) from error
    if code < 0:
        raise BadInput(
            f"network '{path}' crashes OpenCV {cv2.__version__} (signal {-code})",
            "a sound ONNX file",
            "export the network again; do not use a file of unknown origin",
        )


def _parse_size(text: str) -> tuple[int, int]:
    """(width, height) of ``384`` or ``512x384``."""
    width, _, height = text.partition("x")
    height = height or width
    if not (width.isdecimal() and height.isdecimal() and 0 < int(width) <= 8192 and 0 < int(height) <= 8192):
        raise BadInput(f"size={text} in 'onnx'", "a number such as 384, or WIDTHxHEIGHT", "correct size")
    return int(width), int(height)
