"""Results at rest: atomic, plain JSON, lossless frames, and loud about broken files."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from bench.adapters import MethodOutput
from bench.frames import frame_hashes, load_frames, save_frames, stored_precision
from bench.record import CellRecord, Failure, ScoreRecord, jsonable
from bench.store import RunStore, write_json
from orca.errors import BadInput, Unavailable

SPEC = {"id": "m", "title": "M", "variant": "v", "version": "1", "weights_sha256": None}


def a_record() -> CellRecord:
    return CellRecord(
        dataset="photos",
        scene="coffee",
        method="orca",
        method_version="3",
        trajectory_sha256="ab" * 32,
        scores={"m": ScoreRecord(1.25, 3, None, "ok", SPEC, [1.0, 1.5, None], {"curve": [0.5]})},
        frames=frame_hashes(np.zeros((2, 4, 5, 3), np.uint8), (0, 7)),
        timing={"phases": {"fit": 2.0}},
        notes=("as is",),
        failure=Failure("crash", {"given": "g", "allowed": "a", "fix": "f"}, "fit", "Traceback"),
    )


def test_a_record_comes_back_as_it_was(tmp_path: Path) -> None:
    store = RunStore(tmp_path)
    store.save(a_record())
    assert store.load("orca", "coffee") == a_record()
    assert list(store.records()) == [a_record()]
    assert store.load("orca", "rocket") is None


def test_a_writer_that_dies_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "scenes" / "orca" / "a.json"
    write_json(path, {"n": 1})

    def dies(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", dies)
    with pytest.raises(KeyboardInterrupt):
        write_json(path, {"n": 2})
    assert json.loads(path.read_text()) == {"n": 1}
    assert list(path.parent.iterdir()) == [path]


def test_what_a_killed_writer_leaves_is_no_record(tmp_path: Path) -> None:
    store = RunStore(tmp_path)
    store.save(a_record())
    (tmp_path / "scenes" / "orca" / ".coffee-x1y2.json").write_text('{"half": ')
    assert len(list(store.records())) == 1


@pytest.mark.parametrize("content", ["", "{", "[]", '{"schema_version": 99}', '{"schema_version": 2, "scores": 3}'])
def test_a_broken_record_is_refused_by_name(tmp_path: Path, content: str) -> None:
    path = RunStore(tmp_path).record_path("orca", "a")
    path.parent.mkdir(parents=True)
    path.write_text(content)
    with pytest.raises(BadInput, match=r"scenes/orca/a\.json"):
        RunStore(tmp_path).load("orca", "a")


@pytest.mark.parametrize("name", ["../a", "a/b", "..", "", "a\\b", ".hidden"])
def test_no_name_leads_out_of_the_folder(tmp_path: Path, name: str) -> None:
    with pytest.raises(BadInput, match="file name"):
        RunStore(tmp_path).record_path("orca", name)


def test_json_has_no_nan_and_no_infinity() -> None:
    given = {"a": np.float32("nan"), "b": [np.inf, -np.inf], 3: np.arange(2), "p": Path("x"), "t": (True, None, 1.5)}
    assert jsonable(given) == {"a": None, "b": ["inf", "-inf"], "3": [0, 1], "p": "x", "t": [True, None, 1.5]}
    json.dumps(jsonable(given), allow_nan=False)


def an_output(rng: np.random.Generator) -> MethodOutput:
    return MethodOutput(
        frames=rng.integers(0, 256, (3, 11, 7, 3), dtype=np.uint8),
        coverage=rng.random((3, 11, 7), np.float32),
        input_view=rng.integers(0, 256, (11, 7, 3), dtype=np.uint8),
        true_views=(rng.integers(0, 256, (5, 6, 3), dtype=np.uint8),),
        true_view_coverage=(rng.random((5, 6), np.float32),),
        timing={"fit": 1.0, "render_ms_per_frame": 4.0},
        model={"anchors": 5},
        notes=("n",),
    )


def test_frames_come_back_bit_for_bit_as_they_were_scored(tmp_path: Path) -> None:
    output = stored_precision(an_output(np.random.default_rng(0)))
    path = tmp_path / "a.npz"
    save_frames(path, output)
    record = CellRecord(
        "d",
        "s",
        "m",
        "1",
        None,
        frames=frame_hashes(output.frames, (0, 1, 2)),
        timing={"phases": {"fit": 1.0}, "render_ms_per_frame": 4.0},
        model={"anchors": 5},
        notes=("n",),
    )
    back = load_frames(path, record)
    assert back is not None
    for name in ("frames", "coverage", "input_view"):
        np.testing.assert_array_equal(getattr(back, name), getattr(output, name))
    np.testing.assert_array_equal((back.true_views or ())[0], (output.true_views or ())[0])
    np.testing.assert_array_equal((back.true_view_coverage or ())[0], (output.true_view_coverage or ())[0])
    assert (back.timing, back.model, back.notes) == (output.timing, output.model, output.notes)
    assert np.abs((output.coverage if output.coverage is not None else 0) - 0.5).max() <= 0.5


def test_what_a_method_did_not_give_stays_absent(tmp_path: Path) -> None:
    frames = np.zeros((1, 2, 2, 3), np.uint8)
    for true_views in (None, ()):
        save_frames(tmp_path / "a.npz", MethodOutput(frames=frames, true_views=true_views))
        back = load_frames(tmp_path / "a.npz", CellRecord("d", "s", "m", "1", None, frames=frame_hashes(frames, (0,))))
        assert back is not None
        assert (back.coverage, back.input_view, back.true_view_coverage) == (None, None, None)
        assert back.true_views == true_views


def test_a_frame_hash_is_of_the_rgb_bytes() -> None:
    import hashlib

    frame = np.arange(12, dtype=np.uint8).reshape(1, 2, 2, 3)
    assert frame_hashes(frame, (4,))[0].pixel_sha256 == hashlib.sha256(bytes(range(12))).hexdigest()


def test_an_expected_error_keeps_its_three_parts_and_no_traceback() -> None:
    failure = Failure.of(Unavailable("no weights", "w.pth", "get it"), "metric")
    assert (failure.kind, failure.traceback) == ("unavailable", None)
    assert failure.message == {"given": "no weights", "allowed": "w.pth", "fix": "get it"}
