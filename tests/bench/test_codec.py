"""The codec: VistaDream's own settings, shapes kept, repeatable, stated, and part of what a run is."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from bench.adapters import MethodOutput, RunOptions
from bench.codec import ALREADY_CODED, CODEC, _encode, coded_output, holding, through_codec
from bench.datasets.case import SceneCase
from bench.measured import read_runs
from bench.runner import RunRequest, run_bench
from bench.store import RunStore
from orca.errors import BadInput
from orca.registry import Registry
from tests.bench import spine_fakes as fakes
from tests.bench.spine_fakes import FakeDataset, FakeMethod

Images = NDArray[np.uint8]


@pytest.fixture(autouse=True)
def _fresh() -> None:
    fakes.reset()


def clip(n: int = 4, height: int = 48, width: int = 64) -> Images:
    """A smooth picture that moves, with a sharp edge."""
    y, x = np.mgrid[:height, :width]
    frames = [128 + 60 * np.sin((x + 3 * i) / 9) + 40 * (y > 20) for i in range(n)]
    return np.repeat(np.clip(frames, 0, 255).astype(np.uint8)[..., None], 3, axis=3)


def settings(stream: bytes) -> dict[str, str]:
    """The encoder's own note inside an H.264 stream, without what says how many threads it had."""
    found = re.search(rb"x264 - core .*? options: ([ -~]+)", stream)
    assert found is not None
    pairs = (pair.partition("=") for pair in found.group(1).decode().split())
    return {key: value for key, _, value in pairs if "threads" not in key or key == "sliced_threads"}


@pytest.mark.parametrize("name", ["rgb/bear", "rgb/bust", "coarse/car"])
def test_the_settings_are_those_of_the_published_videos(data_root: Path, name: str) -> None:
    published = settings((data_root / "vistadream" / f"{name}.mp4").read_bytes())
    assert published["crf"] == "23.0"
    assert settings(_encode(clip())) == published


def test_pixels_change_a_little_and_the_same_way_each_time() -> None:
    frames = clip()
    once = through_codec(frames)
    assert once.shape == frames.shape
    assert once.dtype == np.uint8
    np.testing.assert_array_equal(once, through_codec(frames))
    error = float(np.mean((once.astype(float) - frames) ** 2))
    assert 0 < error < 30


def test_frames_are_held_up_to_the_next_evaluated_one() -> None:
    assert holding((0, 5, 10, 15, 20, 249)) == 5
    assert holding((0, 1, 2)) == 1
    assert holding((7,)) == 1
    frames = np.random.default_rng(3).integers(0, 256, (4, 48, 64, 3), dtype=np.uint8)  # no neighbour helps another
    lost = [float(np.mean((through_codec(frames, hold).astype(float) - frames) ** 2)) for hold in (1, 5)]
    assert through_codec(frames, 5).shape == frames.shape
    assert lost[1] < lost[0]
    held = through_codec(frames, 5)
    nearest = [[float(np.abs(a.astype(int) - b).mean()) for b in frames] for a in held]
    assert [int(np.argmin(row)) for row in nearest] == [0, 1, 2, 3]


@pytest.mark.parametrize("size", [(47, 64), (48, 63), (31, 31), (1, 1), (6, 8)])
def test_odd_and_tiny_sizes_come_back(size: tuple[int, int]) -> None:
    frames = clip(3, 48, 64)[:, : size[0], : size[1]]
    assert through_codec(np.ascontiguousarray(frames)).shape == frames.shape


@pytest.mark.parametrize(("width", "coded"), [(1, 128), (128, 128), (144, 256), (480, 512), (512, 512), (741, 768)])
def test_rows_are_coded_in_multiples_of_eight_macro_blocks(
    monkeypatch: pytest.MonkeyPatch, width: int, coded: int
) -> None:
    seen = []

    def spy(frames: Images) -> bytes:
        seen.append(frames.shape)
        return _encode(frames)

    monkeypatch.setattr("bench.codec._encode", spy)
    frames = np.full((1, 9, width, 3), 90, np.uint8)
    assert through_codec(frames).shape == frames.shape
    assert seen == [(1, 10, coded, 3)]


@pytest.mark.parametrize(
    "frames",
    [np.zeros((0, 8, 8, 3), np.uint8), np.zeros((2, 8, 8, 3), np.float32), np.zeros((8, 8, 3), np.uint8)],
)
def test_what_is_no_clip_is_refused(frames: Any) -> None:
    with pytest.raises(BadInput, match="a clip of shape"):
        through_codec(frames)


def test_every_picture_of_an_output_is_coded_and_coverage_is_not() -> None:
    frames = clip()
    coverage = np.random.default_rng(0).random((4, 48, 64), np.float32)
    output = MethodOutput(frames=frames, coverage=coverage, input_view=frames[0], true_views=(frames[1][:30],))
    coded = coded_output(output, hold=2)
    assert coded.coverage is coverage
    whole = through_codec(np.concatenate([frames[:1], frames]), 2)
    np.testing.assert_array_equal(coded.input_view, whole[0])
    np.testing.assert_array_equal(coded.frames, whole[1:])
    np.testing.assert_array_equal((coded.true_views or ())[0], through_codec(frames[1:2, :30], 2)[0])


def test_an_input_view_of_another_size_is_a_clip_of_its_own() -> None:
    frames = clip()
    coded = coded_output(MethodOutput(frames=frames, input_view=frames[0, :30, :40]))
    np.testing.assert_array_equal(coded.frames, through_codec(frames))
    np.testing.assert_array_equal(coded.input_view, through_codec(frames[:1, :30, :40])[0])
    assert coded_output(MethodOutput(frames=frames)).input_view is None


@dataclass(frozen=True)
class FakeVideo(FakeMethod):
    """A method whose frames came out of a video, as its output says."""

    def run(self, case: SceneCase, options: RunOptions) -> MethodOutput:
        return replace(super().run(case, options), coded=True)


VIDEO, DARK = FakeVideo("video", 100), FakeMethod("dark", 10)
METHODS: Registry[Any] = Registry("method", {"video": f"{__name__}:VIDEO", "dark": f"{__name__}:DARK"})


def run(out: Path, **changes: Any) -> RunRequest:
    request = replace(RunRequest(FakeDataset(), ("a",), ("dark", "video"), ("bright",), out), **changes)
    run_bench(request, methods=METHODS, metrics=fakes.METRICS)
    return request


def test_a_matched_run_codes_each_method_once_scores_that_and_says_so(tmp_path: Path) -> None:
    run(tmp_path / "raw")
    run(tmp_path / "coded", codec_match=True)
    raw, coded = RunStore(tmp_path / "raw"), RunStore(tmp_path / "coded")
    dark, video = coded.load("dark", "a"), coded.load("video", "a")
    assert dark is not None
    assert video is not None
    assert (dark.codec, video.codec) == (CODEC, ALREADY_CODED)
    before = raw.load("video", "a")
    assert before is not None
    assert (before.codec, before.frames) == (ALREADY_CODED, video.frames)
    plain = raw.load("dark", "a")
    assert plain is not None
    assert plain.codec is None
    assert plain.frames != dark.frames
    caption = read_runs([tmp_path / "coded"]).caption
    assert (
        f"Codec match: every method's frames went through {CODEC} before any metric. video: {ALREADY_CODED}." in caption
    )
    assert f"Frames as rendered, no codec. video: {ALREADY_CODED}." in read_runs([tmp_path / "raw"]).caption


def test_with_and_without_do_not_share_a_folder_or_a_table(tmp_path: Path) -> None:
    request = run(tmp_path / "raw")
    with pytest.raises(BadInput, match=f"a run with codec None; this one has codec {re.escape(CODEC)}"):
        run_bench(replace(request, codec_match=True), methods=METHODS, metrics=fakes.METRICS)
    run(tmp_path / "coded", codec_match=True)
    with pytest.raises(BadInput, match=f"frames with codec None, {re.escape(CODEC)}"):
        read_runs([tmp_path / "raw", tmp_path / "coded"])
