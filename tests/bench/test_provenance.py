"""What a result says of its making: seals, hashes, the score cache, run.json and the long table."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.adapters import RunOptions
from bench.digest import broken_seals, digest, is_sealed, sealed, unsealed
from bench.provenance import case_hashes, code_state, data_block, input_files
from bench.runner import RunRequest, run_bench
from bench.store import RunStore
from orca.errors import BadInput
from tests.bench import spine_fakes as fakes
from tests.bench.spine_fakes import CALLS, SWITCHES, FakeDataset

json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=8,
)
documents = st.dictionaries(
    st.text(min_size=1, max_size=5).filter(lambda k: k not in ("digest", "timing")), json_values
)


@pytest.fixture(autouse=True)
def _fresh() -> None:
    fakes.reset()


@given(documents, st.dictionaries(st.text(max_size=4).filter(lambda k: k != "digest"), json_values, max_size=3))
def test_a_seal_survives_a_file_and_comes_off(document: dict[str, Any], timing: dict[str, Any]) -> None:
    whole = {**document, "timing": timing}
    read = json.loads(json.dumps(sealed(whole)))
    assert is_sealed(read)
    assert not is_sealed(whole)
    assert broken_seals(read) == ()
    assert unsealed(read) == whole
    assert sealed(read) == read


@given(documents, json_values)
def test_a_changed_value_breaks_the_seal(document: dict[str, Any], value: Any) -> None:
    seal = sealed({**document, "score": 1.5})
    changed = {**seal, "score": [value]}
    assert broken_seals(changed) == ("content",)
    assert broken_seals({**seal, "host": {"cores": 3}}) == ("timing or host",)


def test_timing_and_host_do_not_change_the_seal_of_the_rest() -> None:
    one, two = (sealed({"a": 1, "timing": {"s": s}, "host": {"cpu": str(s)}}) for s in (1, 2))
    assert one["digest"] == two["digest"]
    assert one["timing"] != two["timing"]


def test_a_digest_is_of_the_canonical_text() -> None:
    import hashlib

    assert digest({"b": [1, 2.5], "a": "ü"}) == hashlib.sha256('{"a":"ü","b":[1,2.5]}'.encode()).hexdigest()


def go(out: Path, **changes: Any) -> RunStore:
    request = RunRequest(FakeDataset(), ("a", "b"), ("dark", "light"), ("bright", "covered"), out)
    run_bench(replace(request, **changes), methods=fakes.METHODS, metrics=fakes.METRICS)
    return RunStore(out)


def test_each_part_of_a_case_has_a_hash_of_its_own() -> None:
    case = FakeDataset().load("a")
    base = case_hashes(case)
    assert set(base) == {"image", "depth", "camera", "trajectory"}
    image = case.image.copy()
    image[0, 0, 0] += 1
    changes: dict[str, dict[str, Any]] = {
        "image": {"image": image},
        "depth": {"depth": case.depth * np.float32(1.001)},
        "camera": {"camera": replace(case.camera, K=case.camera.K * [[1.01], [1], [1]])},
        "trajectory": {"eval_indices": (0, 2, 3)},
    }
    for part, change in changes.items():
        now = case_hashes(replace(case, **change))
        assert [key for key in base if now[key] != base[key]] == [part]
    assert case_hashes(replace(case, name="other", depth_source="elsewhere")) == base


def test_a_file_belongs_to_the_scene_whose_name_it_has(tmp_path: Path) -> None:
    names = ("d/images/bear.png", "d/depth/bear.png", "d/bear_depth.npy", "d/bears.png", "d/deep/er/still/x/bear.png")
    for name in (*names, "other/bear.png", "m/rgb/bear.mp4"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(name)
    found = input_files(tmp_path, None, ("d", "m", "absent"), "bear")
    assert list(found) == ["d/bear_depth.npy", "d/depth/bear.png", "d/images/bear.png", "m/rgb/bear.mp4"]
    assert input_files(None, tmp_path / "d", ("d",), "bear").keys() == {
        "bear_depth.npy",
        "depth/bear.png",
        "images/bear.png",
    }
    assert input_files(None, None, ("d",), "bear") == {}


def test_run_json_says_what_a_reviewer_asks(tmp_path: Path) -> None:
    config = {"anchors": 5}
    store = go(tmp_path, preset_config=config, argv=("run", "--seed", "3"), options=RunOptions(seed=3), command="c")
    run = store.load_run()
    assert run is not None
    assert run["preset_config"] == config
    assert run["argv"] == [["run", "--seed", "3"]]
    assert (run["identity"]["seed"], run["identity"]["device"], run["identity"]["codec"]) == (3, "cpu", None)
    assert set(run["code"]) == {"commit", "dirty"}
    assert run["host"]["versions"]["numpy"]
    assert run["host"]["threads"] >= 1
    assert run["metric_specs"]["bright"]["weights_sha256"] is None
    assert run["data"]["scenes"]["a"]["trajectory"]
    assert run["data"]["revision"] == digest(run["data"]["scenes"])
    assert run["timing"]["started"][:2] == "20"
    started, revision = run["timing"]["started"], run["data"]["revision"]
    go(tmp_path, scenes=("c",), options=RunOptions(seed=3), argv=("run", "--scenes", "c"))
    run = store.load_run()
    assert run is not None
    assert (run["timing"]["started"], len(run["argv"])) == (started, 2)
    assert sorted(run["data"]["scenes"]) == ["a", "b", "c"]
    assert run["data"]["revision"] != revision


def test_the_code_state_is_a_commit_or_nothing() -> None:
    state = code_state()
    assert state["commit"] is None or len(state["commit"]) == 40
    assert (state["dirty"] is None) == (state["commit"] is None)


def test_a_data_revision_is_of_the_contents_only() -> None:
    assert data_block({"a": {"x": "1"}, "b": {"x": "2"}}) == data_block({"b": {"x": "2"}, "a": {"x": "1"}})
    assert data_block({"a": {"x": "1"}})["revision"] != data_block({"a": {"x": "2"}})["revision"]


def test_a_scene_whose_image_changed_gets_no_new_scores(tmp_path: Path) -> None:
    class Brighter(FakeDataset):
        def load(self, scene: str) -> Any:
            case = super().load(scene)
            return replace(case, image=case.image + np.uint8(1))

    go(tmp_path, metrics=("bright",))
    with pytest.raises(BadInput, match="the image of scene a changed since dark ran"):
        go(tmp_path, dataset=Brighter())


def test_equal_content_is_scored_once_over_methods_and_runs(tmp_path: Path) -> None:
    methods = ("dark", "also-dark", "light")
    one = go(tmp_path / "one", methods=methods, scenes=("a",), score_cache=tmp_path / "cache")
    assert (CALLS["bright"], CALLS["covered"]) == (2, 2)  # dark and also-dark return the same pixels
    CALLS.clear()
    two = go(tmp_path / "two", methods=methods, scenes=("a",), score_cache=tmp_path / "cache")
    assert (CALLS["bright"], CALLS["covered"], CALLS["run dark a"]) == (0, 0, 1)
    for method in methods:
        first, second = one.load(method, "a"), two.load(method, "a")
        assert first is not None
        assert second is not None
        assert first.scores == second.scores


@pytest.mark.parametrize("change", ["spec", "image", "cameras", "pixels", "damage"])
def test_other_content_or_another_spec_is_scored_anew(tmp_path: Path, change: str) -> None:
    cache = tmp_path / "cache"
    common: dict[str, Any] = {"scenes": ("a",), "methods": ("dark",), "metrics": ("bright",), "score_cache": cache}
    go(tmp_path / "one", **common)
    CALLS.clear()
    if change == "spec":
        SWITCHES["bright version"] = "2"
    elif change == "image":
        common["scenes"] = ("b",)
    elif change == "cameras":
        common["dataset"] = FakeDataset(shift=0.1)
    elif change == "pixels":
        common["methods"] = ("light",)
    else:
        path = next(cache.glob("*/*.json"))
        path.write_text(path.read_text().replace("11.0", "12.0"))
    store = go(tmp_path / "two", **common)
    assert CALLS["bright"] == 1
    record = store.load(common["methods"][0], common["scenes"][0])
    assert record is not None
    assert record.scores["bright"].value == (201.0 if change == "pixels" else 11.0)


def test_a_metric_that_needs_only_frames_is_found_under_other_cameras(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fakes.Bright, "needs", ("frames",), raising=False)
    common: dict[str, Any] = {"scenes": ("a",), "methods": ("dark",), "score_cache": tmp_path / "cache"}
    go(tmp_path / "one", **common)
    CALLS.clear()
    go(tmp_path / "two", dataset=FakeDataset(shift=0.1), **common)
    assert (CALLS["bright"], CALLS["covered"]) == (0, 1)


def test_failures_are_not_kept_in_the_cache(tmp_path: Path) -> None:
    SWITCHES["bright"] = "crash"
    common: dict[str, Any] = {"scenes": ("a",), "methods": ("dark",), "metrics": ("bright", "learned")}
    go(tmp_path, **common)
    SWITCHES.clear()
    CALLS.clear()
    go(tmp_path, retry_failed=True, **common)
    assert CALLS["bright"] == 1
    assert CALLS["learned"] == 1


def test_the_long_table_has_every_score_and_every_frame(tmp_path: Path) -> None:
    SWITCHES["light b"] = "crash"
    store = go(tmp_path, codec_match=False)
    rows = pq.read_table(tmp_path / "scores.parquet").to_pylist()
    of = [r for r in rows if (r["scene"], r["method"], r["metric"]) == ("a", "dark", "bright")]
    assert [(r["frame"], r["value"]) for r in of] == [(None, 11.0), (0, 10.0), (1, 11.0), (2, 12.0)]
    record = store.load("dark", "a")
    assert record is not None
    assert [(r["frame_index"], r["pixel_sha256"]) for r in of[1:]] == [(f.index, f.pixel_sha256) for f in record.frames]
    assert {r["trajectory_sha256"] for r in of} == {record.trajectory_sha256}
    failed = [r for r in rows if r["status"] == "failed"]
    assert [(r["scene"], r["method"], r["metric"]) for r in failed] == [("b", "light", None)]
    assert "percentile of an empty array" in failed[0]["reason"]
    before = (tmp_path / "scores.parquet").read_bytes()
    (tmp_path / "scores.parquet").unlink()
    go(tmp_path)
    assert (tmp_path / "scores.parquet").read_bytes() == before
