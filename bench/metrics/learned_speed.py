"""How fast MUSIQ and CLIP-IQA are here, as a ratio to pyiqa on the same frames, threads and weights, in one process."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from bench.metrics.clip_iqa_network import MEAN, STD, pyiqa_pairs
from bench.metrics.clip_prompts import FIVE_PAIRS, PROMPT_PAIRS
from bench.metrics.musiq import as_image
from bench.metrics.musiq_network import CpuMusiq
from bench.speed.threads import limited_to
from bench.speed.timing import Patience, Sample, alternate, paired_ratio, stopwatch
from orca.conventions import UInt8Array
from orca.threads import map_on_cores

__all__ = ["LEARNED_CASES", "LearnedSpeed", "measure_learned_speed"]

LEARNED_CASES = ("musiq", "clipiqa")
FRAMES, AT_ONCE, SIDE = 50, 10, 512

Scores = Callable[[list[UInt8Array]], list[float]]


@dataclass(frozen=True)
class LearnedSpeed:
    """Two ways to score the same frames, in turns.

    Attributes:
        case: the metric.
        way: what was timed, in words, against pyiqa's own call for each frame.
        frames, side, threads: how many distinct frames, their width and height, threads that both may use.
        theirs, ours: wall and CPU seconds of each round of frames.
        largest_difference: of any score.
    """

    case: str
    way: str
    frames: int
    side: int
    threads: int
    theirs: tuple[Sample, ...]
    ours: tuple[Sample, ...]
    largest_difference: float

    def to_json(self) -> dict[str, Any]:
        """Plain data, the ratios included."""
        wall, low, high, cpu = paired_ratio(list(self.theirs), list(self.ours))
        return {
            "case": self.case,
            "way": self.way,
            "frames": self.frames,
            "side": self.side,
            "threads": self.threads,
            "pyiqa_s_per_frame": sum(s.wall_s for s in self.theirs) / self.frames,
            "s_per_frame": sum(s.wall_s for s in self.ours) / self.frames,
            "ratio": {"wall": wall, "wall_low": low, "wall_high": high, "cpu": cpu},
            "largest_difference": self.largest_difference,
        }

    def line(self) -> str:
        """One line for people."""
        plain = self.to_json()
        ratio = plain["ratio"]
        return (
            f"{self.case}, {self.way}: {plain['s_per_frame']:.3f} s a frame against {plain['pyiqa_s_per_frame']:.3f} "
            f"of pyiqa, {self.threads} threads, {self.frames} frames of {self.side}x{self.side}: "
            f"{ratio['wall']:.2f} times as fast ({ratio['wall_low']:.2f} to {ratio['wall_high']:.2f}; CPU time "
            f"{ratio['cpu']:.2f}); scores within {self.largest_difference:.1g}"
        )


def measure_learned_speed(
    case: str, frames: int = FRAMES, side: int = SIDE, threads: int = 2, at_once: int = AT_ONCE
) -> list[LearnedSpeed]:
    """Time one of `LEARNED_CASES` on distinct frames of noise; random weights, since their values cost no time.

    Args:
        case: "musiq" or "clipiqa".
        frames: how many; each way scores every one of them once.
        side: width and height.
        threads: threads that each way may use.
        at_once: frames in a round: the ways take turns after so many.
    """
    torch.manual_seed(0)
    rng = np.random.default_rng(0)
    pictures = [rng.integers(0, 256, (side, side, 3), dtype=np.uint8) for _ in range(frames + 2)]
    with limited_to(threads), torch.inference_mode():
        theirs, ways = _musiq() if case == "musiq" else _clipiqa()
        rounds = [pictures[:2], *(pictures[k : k + at_once] for k in range(2, frames + 2, at_once))]
        return _in_turns(case, side, threads, rounds, {"pyiqa": theirs, **ways})


def _in_turns(
    case: str, side: int, threads: int, rounds: Sequence[list[UInt8Array]], ways: dict[str, Scores]
) -> list[LearnedSpeed]:
    """Time all ways; the first is pyiqa, the first round warms up."""
    found: dict[str, list[float]] = {way: [] for way in ways}

    def work(way: str) -> Callable[[int], Sample]:
        return lambda number: stopwatch(lambda: found[way].extend(ways[way](rounds[number])))

    patience = Patience(warmup=1, repeats=len(rounds) - 1, least=len(rounds) - 1, seconds=0.0)
    samples = alternate({way: work(way) for way in ways}, patience)
    base, *others = ways
    count = sum(len(some) for some in rounds[1:])
    return [
        LearnedSpeed(
            case,
            way,
            count,
            side,
            threads,
            tuple(samples[base]),
            tuple(samples[way]),
            float(np.abs(np.array(found[way]) - np.array(found[base])).max()),
        )
        for way in others
    ]


def _musiq() -> tuple[Scores, dict[str, Scores]]:
    import pyiqa

    metric = pyiqa.create_metric("musiq", pretrained=False, device=torch.device("cpu"))
    network = CpuMusiq(metric.net)
    return (
        lambda frames: [float(metric(as_image(frame))) for frame in frames],
        {"one frame per core": lambda frames: list(map_on_cores(lambda frame: network(as_image(frame)), frames))},
    )


def _clipiqa() -> tuple[Scores, dict[str, Scores]]:
    """RN50; pyiqa encodes its ten texts again with every image."""
    from pyiqa.archs.clip_imports import clip
    from pyiqa.archs.clip_model import CLIP, build_model

    state = CLIP(1024, 224, (3, 4, 6, 3), 64, None, 77, 49408, 512, 8, 12).state_dict()
    theirs, ours = build_model(dict(state)).float(), pyiqa_pairs(state, "cpu")
    tokens = clip.tokenize([text for pair in PROMPT_PAIRS[FIVE_PAIRS] for text in pair])
    mean, std = (torch.tensor(x).view(1, 3, 1, 1) for x in (MEAN, STD))

    def as_pyiqa(frame: UInt8Array) -> float:
        logits, _ = theirs((as_image(frame) - mean) / std, tokens, pos_embedding=False)
        return float(logits.view(-1, 2).softmax(dim=-1)[:, 0].mean())

    def once(frame: UInt8Array) -> float:
        return float(ours(frame)[FIVE_PAIRS].mean())

    return (
        lambda frames: [as_pyiqa(frame) for frame in frames],
        {
            "texts once": lambda frames: [once(frame) for frame in frames],
            "texts once, one frame per core": lambda frames: list(map_on_cores(once, frames)),
        },
    )
