"""The metrics `clipiqa` (through pyiqa), and `clipiqa_openclip` and `clipiqa_photo` (through open_clip)."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from bench.metrics.clip_prompts import FIVE_PAIRS, PHOTO_PAIR, PROMPT_PAIRS
from bench.metrics.metric import MetricInput, MetricSpec, Score
from bench.metrics.per_frame import check_frames, distinct_frames, mean_of_values
from bench.metrics.weights import WeightsFile
from orca.conventions import Float32Array, UInt8Array
from orca.errors import BadInput

if TYPE_CHECKING:
    from bench.metrics.clip_iqa_network import ClipPairs

__all__ = ["CLIP_RN50", "ClipIqa", "ClipIqaOpenClip"]

_SHA256 = "afeb0e10f9e5a86da6080e35cf09123aca3b358a0c3e3b6c78a7b63bc04b6762"
CLIP_RN50 = WeightsFile(
    "clipiqa", "RN50.pt", f"https://openaipublic.azureedge.net/clip/models/{_SHA256}/RN50.pt", _SHA256
)
SMALLEST = 32  # the network halves an image five times
NO_VALUE = f"a side is below {SMALLEST} pixels, or the model gave no finite score"


class _ClipIqaFamily:
    """Frames through CLIP, loaded once; equal frames once."""

    needs = ("frames", "shape")
    route: str

    def __init__(self) -> None:
        self._loaded: tuple[tuple[Path, str], ClipPairs] | None = None

    def _probabilities(self, given: MetricInput) -> tuple[list[Float32Array | None], int]:
        """For each frame the probability of the better text of each pair; and how many frames differ."""
        frames = given.output.frames
        check_frames(frames)
        path = CLIP_RN50.find(given.weights_dir)
        CLIP_RN50.check(given.weights_dir)  # a TorchScript archive holds code: read no other than the published one
        if min(frames.shape[1:3]) < SMALLEST:
            return [None] * len(frames), len(distinct_frames(frames)[0])
        key = (path, given.device)
        if self._loaded is None or self._loaded[0] != key:
            self._loaded = (key, _build(self.route, path, given.device))
        distinct, which = distinct_frames(frames)
        found = _each(self._loaded[1], distinct, given.device)
        return [found[k] for k in which], len(distinct)

    def _spec(self, metric_id: str, title: str, prompts: str, made_by: str, weights_dir: Path | None) -> MetricSpec:
        variant = f"CLIP RN50 (OpenAI), no positional embedding, frames at their size, {prompts}; mean over frames"
        digest = CLIP_RN50.sha256(weights_dir)
        return MetricSpec(metric_id, title, True, (0.0, 1.0), variant, made_by, 4, digest)


class ClipIqa(_ClipIqaFamily):
    """CLIP-IQA as pyiqa computes it."""

    route = "pyiqa"

    def specs(self, weights_dir: Path | None) -> tuple[MetricSpec, ...]:
        """The spec of `clipiqa`."""
        made_by = f"pyiqa {version('pyiqa')}"
        return (self._spec("clipiqa", "CLIP-IQA", "mean over pyiqa's five prompt pairs", made_by, weights_dir),)

    def compute(self, given: MetricInput) -> dict[str, Score]:
        """Score the frames.

        Raises:
            Unavailable: the weights are not there.
            BadInput: another file has their name, or the frames are not [n, H, W, 3] uint8.
        """
        return {"clipiqa": _score(*self._probabilities(given), FIVE_PAIRS)}


class ClipIqaOpenClip(_ClipIqaFamily):
    """CLIP-IQA without pyiqa: the same five pairs, and the one pair of the CLIP-IQA paper."""

    route = "open_clip"

    def specs(self, weights_dir: Path | None) -> tuple[MetricSpec, ...]:
        """The specs of `clipiqa_openclip` and `clipiqa_photo`."""
        made_by, photo = f"open_clip {version('open_clip_torch')}", PROMPT_PAIRS[PHOTO_PAIR]
        five = "mean over pyiqa's five prompt pairs"
        return (
            self._spec("clipiqa_openclip", "CLIP-IQA (open_clip)", five, made_by, weights_dir),
            self._spec(
                "clipiqa_photo", "CLIP-IQA (photo)", f"prompts {photo[0]!r}, {photo[1]!r}", made_by, weights_dir
            ),
        )

    def compute(self, given: MetricInput) -> dict[str, Score]:
        """Score the frames. Raises as `ClipIqa.compute` does."""
        found, distinct = self._probabilities(given)
        return {
            "clipiqa_openclip": _score(found, distinct, FIVE_PAIRS),
            "clipiqa_photo": _score(found, distinct, slice(PHOTO_PAIR, PHOTO_PAIR + 1)),
        }


def _build(route: str, path: Path, device: str) -> ClipPairs:
    from bench.metrics.clip_iqa_network import open_clip_pairs, pyiqa_pairs, read_clip_state

    state = read_clip_state(path)
    try:
        return pyiqa_pairs(state, device) if route == "pyiqa" else open_clip_pairs(state, device)
    except (KeyError, RuntimeError, IndexError) as error:
        raise BadInput(
            f"{path} is not CLIP RN50 ({type(error).__name__}: {str(error)[:200]})",
            f"the published file, SHA-256 {_SHA256}",
            f"get it from {CLIP_RN50.source}",
        ) from error


def _each(network: ClipPairs, frames: list[UInt8Array], device: str) -> list[Float32Array]:
    from orca.threads import map_on_cores

    return list(map_on_cores(network, frames)) if device == "cpu" else [network(frame) for frame in frames]


def _score(found: list[Float32Array | None], distinct: int, pairs: slice) -> Score:
    """The mean over frames of the mean over some pairs."""
    return mean_of_values([None if p is None else float(p[pairs].mean()) for p in found], NO_VALUE, distinct)
