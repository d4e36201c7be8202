"""Video files: what goes in comes out, in order; broken files and indices are typed errors."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from orca.errors import BadInput
from orca.video import read_video, write_video


def grey_steps(n: int, height: int = 48, width: int = 64) -> np.ndarray:
    """Frame i is uniformly 10 + 8 i: its number can be read off its colour."""
    return np.stack([np.full((height, width, 3), 10 + 8 * i, np.uint8) for i in range(n)])


def numbers(frames: np.ndarray) -> list[int]:
    return [round((float(f.mean()) - 10) / 8) for f in frames]


def test_round_trip_is_close_and_in_order(tmp_path: Path) -> None:
    y, x = np.mgrid[0:64, 0:96]
    frames = np.stack([np.stack([x + 20 + 5 * i, y + 90 - 5 * i, (x + y) / 2 + 60], -1) for i in range(9)])
    frames = frames.clip(0, 255).astype(np.uint8)
    write_video(tmp_path / "new" / "a.mp4", iter(frames), fps=20, crf=10)
    back = read_video(tmp_path / "new" / "a.mp4")
    assert back.shape == frames.shape
    assert back.dtype == np.uint8
    assert np.abs(back.astype(int) - frames).mean() < 2.0


def test_colours_keep_their_places(tmp_path: Path) -> None:
    frame = np.zeros((64, 96, 3), np.uint8)
    frame[:, :32], frame[:, 32:64], frame[:, 64:] = (200, 30, 30), (30, 200, 30), (30, 30, 200)
    write_video(tmp_path / "a.mp4", [frame] * 3)
    back = read_video(tmp_path / "a.mp4")[1]
    for x, colour in ((16, (200, 30, 30)), (48, (30, 200, 30)), (80, (30, 30, 200))):
        assert np.abs(back[32, x].astype(int) - colour).max() < 8


def test_indices_in_any_order_with_repeats(tmp_path: Path) -> None:
    write_video(tmp_path / "a.mp4", grey_steps(20))
    assert numbers(read_video(tmp_path / "a.mp4", [0, 19, 7, 7, 3])) == [0, 19, 7, 7, 3]
    assert numbers(read_video(tmp_path / "a.mp4")) == list(range(20))


def test_odd_sizes_get_one_repeated_row_and_column(tmp_path: Path) -> None:
    frames = grey_steps(3, 47, 63)
    write_video(tmp_path / "a.mp4", frames)
    back = read_video(tmp_path / "a.mp4")
    assert back.shape == (3, 48, 64, 3)
    assert np.abs(back.astype(int) - grey_steps(3, 48, 64)).max() <= 3


def test_frame_rate_is_stored(tmp_path: Path) -> None:
    import av

    write_video(tmp_path / "a.mp4", grey_steps(4), fps=12.5)
    with av.open(str(tmp_path / "a.mp4")) as container:
        stream = container.streams.video[0]
        assert float(stream.average_rate) == pytest.approx(12.5)
        assert stream.codec_context.pix_fmt == "yuv420p"


def test_a_lower_crf_is_closer(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (2, 64, 64, 3), dtype=np.uint8)
    error = {}
    for crf in (5, 40):
        write_video(tmp_path / f"{crf}.mp4", noise, crf=crf)
        error[crf] = np.abs(read_video(tmp_path / f"{crf}.mp4").astype(int) - noise).mean()
    assert error[5] < error[40]


@pytest.mark.parametrize("indices", [[20], [0, 100], [-1], []])
def test_indices_outside_the_video(tmp_path: Path, indices: list[int]) -> None:
    write_video(tmp_path / "a.mp4", grey_steps(20))
    with pytest.raises(BadInput):
        read_video(tmp_path / "a.mp4", indices)


def test_the_error_tells_how_many_frames_there_are(tmp_path: Path) -> None:
    write_video(tmp_path / "a.mp4", grey_steps(5))
    with pytest.raises(BadInput, match="has 5 frames; frame 9"):
        read_video(tmp_path / "a.mp4", [1, 9])


def test_unreadable_files(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="no such video"):
        read_video(tmp_path / "none.mp4")
    (tmp_path / "text.mp4").write_text("this is not a video")
    (tmp_path / "empty.mp4").write_bytes(b"")
    write_video(tmp_path / "a.mp4", grey_steps(20))
    (tmp_path / "cut.mp4").write_bytes((tmp_path / "a.mp4").read_bytes()[:900])
    for name in ("text.mp4", "empty.mp4", "cut.mp4"):
        with pytest.raises(BadInput):
            read_video(tmp_path / name, [19])


def test_a_file_with_sound_only(tmp_path: Path) -> None:
    import av

    with av.open(str(tmp_path / "a.wav"), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=8000, layout="mono")
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), format="s16", layout="mono")
        frame.sample_rate = 8000
        container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    with pytest.raises(BadInput, match="no video stream"):
        read_video(tmp_path / "a.wav")


def broken(kind: str) -> Iterator[np.ndarray]:
    yield grey_steps(1)[0]
    yield {
        "size": grey_steps(1, 32, 32)[0],
        "float": grey_steps(1)[0].astype(np.float32),
        "grey": grey_steps(1)[0][..., 0],
    }[kind]


@pytest.mark.parametrize("kind", ["size", "float", "grey"])
def test_bad_frames_leave_the_old_file_and_no_other(tmp_path: Path, kind: str) -> None:
    target = tmp_path / "a.mp4"
    target.write_text("the old one")
    with pytest.raises(BadInput):
        write_video(target, broken(kind))
    assert target.read_text() == "the old one"
    assert list(tmp_path.iterdir()) == [target]


def test_no_frames_and_bad_settings(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="no frames"):
        write_video(tmp_path / "a.mp4", [])
    for settings in ({"fps": 0.0}, {"crf": 52}, {"crf": -1}):
        with pytest.raises(BadInput):
            write_video(tmp_path / "a.mp4", grey_steps(2), **settings)
    assert list(tmp_path.iterdir()) == []


def test_a_published_video(data_root: Path) -> None:
    frames = read_video(data_root / "vistadream" / "rgb" / "bust.mp4", [0, 249])
    assert frames.shape == (2, 480, 480, 3)
    assert np.abs(frames[0].astype(int) - frames[1]).mean() < 5  # first and last are both the input view
    with pytest.raises(BadInput, match="has 250 frames"):
        read_video(data_root / "vistadream" / "rgb" / "bust.mp4", [250])
