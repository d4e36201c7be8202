"""A run: what is computed, what is kept, what fails and how, and what is refused."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from bench.adapters import RunOptions
from bench.runner import RunRequest, RunSummary, run_bench
from bench.store import RunStore
from orca.errors import BadInput, Unknown
from tests.bench import spine_fakes as fakes
from tests.bench.spine_fakes import CALLS, SWITCHES, FakeDataset


@pytest.fixture(autouse=True)
def _fresh() -> None:
    fakes.reset()


@pytest.fixture
def request_(tmp_path: Path) -> RunRequest:
    return RunRequest(FakeDataset(), ("a", "b"), ("dark", "light"), ("bright", "covered"), tmp_path / "run")


def go(request: RunRequest, **changes: Any) -> RunSummary:
    return run_bench(replace(request, **changes), methods=fakes.METHODS, metrics=fakes.METRICS)


def cell(request: RunRequest, method: str, scene: str) -> dict[str, Any]:
    document = json.loads((request.out / "scenes" / method / f"{scene}.json").read_text())
    assert isinstance(document, dict)
    return document


def test_a_record_holds_what_the_contract_says(request_: RunRequest) -> None:
    summary = go(request_)
    assert (summary.computed, summary.skipped, summary.failed) == (4, 0, ())
    record = cell(request_, "light", "a")
    assert record["schema_version"] == 2
    assert (record["dataset"], record["scene"], record["method"], record["method_version"]) == (
        "fake",
        "a",
        "light",
        "1",
    )
    score = record["scores"]["bright"]
    assert (score["value"], score["n"], score["reason"], score["per_frame"]) == (201.0, 3, None, [200.0, 201.0, 202.0])
    assert score["spec"]["variant"] == "mean"
    assert score["detail"] == {"worst": "inf"}
    assert [frame["index"] for frame in record["frames"]] == [0, 2, 4]
    assert all(len(frame["pixel_sha256"]) == 64 for frame in record["frames"])
    assert record["trajectory_sha256"] == FakeDataset().load("a").trajectory.sha256
    assert record["timing"]["phases"] == {"fit": 1.5, "render": 0.5}
    assert record["timing"]["render_ms_per_frame"] == 20.0
    assert set(record["timing"]["metrics"]) == {"Bright", "Covered"}
    assert record["host"]["versions"]["numpy"]
    assert record["model"]["anchors"] == 100
    assert record["failure"] is None


def test_each_scene_is_loaded_once_and_each_family_computed_once(request_: RunRequest) -> None:
    go(request_, metrics=("bright", "brightest", "covered"))
    assert CALLS["load a"] == 1
    assert CALLS["bright"] == 4  # two ids of one class: one call for each of the 2x2 cells


def test_rerun_computes_nothing_and_loads_nothing(request_: RunRequest) -> None:
    go(request_)
    before = {path: path.stat().st_mtime_ns for path in request_.out.glob("scenes/*/*.json")}
    CALLS.clear()
    summary = go(request_)
    assert (summary.computed, summary.skipped) == (0, 4)
    assert not CALLS
    assert before == {path: path.stat().st_mtime_ns for path in request_.out.glob("scenes/*/*.json")}


def test_a_new_metric_is_computed_from_stored_frames_and_gives_the_same_score(request_: RunRequest) -> None:
    go(request_, metrics=("covered",), scenes=("a",))
    fresh = cell(request_, "dark", "a")["scores"]["covered"]["value"]
    other = replace(request_, out=request_.out.with_name("later"), scenes=("a",))
    go(other, metrics=("bright",))
    CALLS.clear()
    summary = go(other, metrics=("bright", "covered"))
    assert summary.computed == 2
    assert {key for key in CALLS if key.startswith("run")} == set()
    assert (CALLS["covered"], CALLS["bright"]) == (2, 0)
    assert cell(other, "dark", "a")["scores"]["covered"]["value"] == fresh
    assert cell(other, "dark", "a")["scores"]["bright"]["value"] == 11.0


@pytest.mark.parametrize("damage", ["gone", "broken", "other pixels"])
def test_frames_that_are_gone_or_wrong_make_the_method_run_again(request_: RunRequest, damage: str) -> None:
    go(request_, metrics=("bright",), scenes=("a",))
    path = RunStore(request_.out).frames_path("dark", "a")
    if damage == "gone":
        path.unlink()
    elif damage == "broken":
        path.write_bytes(path.read_bytes()[:200])
    else:
        path.write_bytes(RunStore(request_.out).frames_path("light", "a").read_bytes())
    CALLS.clear()
    go(request_, metrics=("covered",), scenes=("a",), methods=("dark",))
    assert CALLS["run dark a"] == 1
    scores = cell(request_, "dark", "a")["scores"]
    assert scores["covered"]["value"] == pytest.approx(0.3, abs=1 / 255)


def test_finished_scores_survive_when_frames_are_gone_and_the_method_now_fails(request_: RunRequest) -> None:
    go(request_, metrics=("bright",), scenes=("a",), methods=("dark",))
    RunStore(request_.out).frames_path("dark", "a").unlink()
    SWITCHES["dark a"] = "crash"
    summary = go(request_, metrics=("bright", "covered"), scenes=("a",), methods=("dark",))
    scores = cell(request_, "dark", "a")["scores"]
    assert scores["bright"]["value"] == 11.0
    assert scores["covered"]["status"] == "failed"
    assert summary.failed == (("dark", "a"),)


def test_a_metric_with_another_spec_is_computed_again(request_: RunRequest) -> None:
    go(request_)
    CALLS.clear()
    SWITCHES["bright version"] = "2"
    go(request_)
    assert (CALLS["bright"], CALLS["covered"]) == (4, 0)
    assert cell(request_, "dark", "b")["scores"]["bright"]["spec"]["version"] == "2"


def test_a_method_of_another_version_runs_again(request_: RunRequest) -> None:
    go(request_)
    CALLS.clear()
    SWITCHES["version"] = "2"
    assert go(request_).computed == 4
    assert CALLS["run dark a"] == 1
    assert cell(request_, "dark", "a")["method_version"] == "2"


def test_a_crash_is_a_typed_record_and_the_run_goes_on(request_: RunRequest) -> None:
    SWITCHES["dark a"] = "crash"
    SWITCHES["dark b"] = "bad input"
    summary = go(request_)
    assert summary.failed == (("dark", "a"), ("dark", "b"))
    crash, refused = (cell(request_, "dark", scene) for scene in "ab")
    assert crash["failure"]["kind"] == "crash"
    assert crash["failure"]["phase"] == "fit"
    assert "percentile of an empty array" in crash["failure"]["message"]["given"]
    assert "IndexError" in crash["failure"]["traceback"]
    assert (crash["scores"], crash["frames"]) == ({}, [])
    assert refused["failure"]["kind"] == "bad_input"
    assert refused["failure"]["message"]["fix"] == "choose another"
    assert refused["failure"]["traceback"] is None
    assert cell(request_, "light", "a")["scores"]["bright"]["value"] == 201.0


def test_failures_are_run_again_only_when_asked(request_: RunRequest) -> None:
    SWITCHES["dark a"] = "crash"
    go(request_)
    SWITCHES.clear()
    CALLS.clear()
    assert go(request_).failed == (("dark", "a"),)
    assert not CALLS
    assert go(request_, retry_failed=True).failed == ()
    assert [key for key in CALLS if key.startswith("run")] == ["run dark a"]
    assert cell(request_, "dark", "a")["failure"] is None


@pytest.mark.parametrize(("what", "words"), [("short", r"uint8 \[2, 6, 8, 3\]"), ("nan", "values from nan")])
def test_nonsense_from_a_method_is_a_failure(request_: RunRequest, what: str, words: str) -> None:
    SWITCHES["dark a"] = what
    go(request_, scenes=("a",))
    failure = cell(request_, "dark", "a")["failure"]
    assert failure["kind"] == "bad_output"
    assert re.search(words, failure["message"]["given"])


def test_a_scene_that_does_not_load_fails_for_every_method_once(request_: RunRequest) -> None:
    summary = go(request_, dataset=FakeDataset(broken=frozenset("a")))
    assert summary.failed == (("dark", "a"), ("light", "a"))
    assert CALLS["load a"] == 1
    record = cell(request_, "light", "a")
    assert (record["failure"]["kind"], record["failure"]["phase"]) == ("bad_input", "load")
    assert record["trajectory_sha256"] is None


@pytest.mark.parametrize("what", ["crash", "nan"])
def test_a_broken_metric_fails_its_scores_only(request_: RunRequest, what: str) -> None:
    SWITCHES["bright"] = what
    summary = go(request_, metrics=("bright", "brightest", "covered"), scenes=("a",), methods=("dark",))
    assert summary.failed == (("dark", "a"),)
    scores = cell(request_, "dark", "a")["scores"]
    assert {key: score["status"] for key, score in scores.items()} == {
        "bright": "failed",
        "brightest": "failed",
        "covered": "ok",
    }
    assert scores["bright"]["value"] is None
    assert scores["bright"]["reason"]
    if what == "crash":
        assert scores["bright"]["reason"].startswith("crash: ZeroDivisionError")
        assert "ZeroDivisionError" in scores["bright"]["detail"]["traceback"]


def test_missing_weights_are_not_a_failure_and_are_tried_again_when_asked(request_: RunRequest) -> None:
    summary = go(request_, metrics=("learned",), scenes=("a",), methods=("dark",))
    assert summary.failed == ()
    score = cell(request_, "dark", "a")["scores"]["learned"]
    assert (score["value"], score["status"]) == (None, "unavailable")
    assert "w.pth" in score["reason"]
    SWITCHES["weights"] = "here"
    go(request_, metrics=("learned",), scenes=("a",), methods=("dark",))
    assert CALLS["learned"] == 1
    go(request_, metrics=("learned",), scenes=("a",), methods=("dark",), retry_failed=True)
    assert cell(request_, "dark", "a")["scores"]["learned"]["value"] == 5.0
    assert CALLS["run dark a"] == 1


def test_an_interrupt_keeps_finished_work_and_the_same_call_goes_on(request_: RunRequest) -> None:
    SWITCHES["dark b"] = "interrupt"
    with pytest.raises(KeyboardInterrupt):
        go(request_)
    SWITCHES.clear()
    CALLS.clear()
    summary = go(request_)
    assert (summary.computed, summary.skipped) == (2, 2)
    assert CALLS["run dark a"] == 0


def test_an_interrupt_between_method_and_metric_costs_no_method_run(request_: RunRequest) -> None:
    SWITCHES["bright"] = "interrupt"
    with pytest.raises(KeyboardInterrupt):
        go(request_, metrics=("covered", "bright"))
    record = cell(request_, "dark", "a")
    assert set(record["scores"]) == {"covered"}
    SWITCHES.clear()
    CALLS.clear()
    go(request_, metrics=("covered", "bright"))
    assert CALLS["run dark a"] == 0
    assert CALLS["covered"] == 3


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"options": RunOptions(preset="paper")}, "preset draft; this one has preset paper"),
        ({"options": RunOptions(seed=3)}, "seed 0; this one has seed 3"),
        ({"trajectory": "orbit"}, "trajectory None; this one has trajectory orbit"),
        ({"dataset": FakeDataset(name="other")}, "dataset fake; this one has dataset other"),
    ],
)
def test_another_run_in_the_same_folder_is_refused(request_: RunRequest, changes: dict[str, Any], words: str) -> None:
    go(request_)
    CALLS.clear()
    with pytest.raises(BadInput, match=words):
        go(request_, **changes)
    assert not CALLS


def test_a_data_set_whose_cameras_changed_is_refused(request_: RunRequest) -> None:
    go(request_, metrics=("bright",))
    with pytest.raises(BadInput, match="scene a has other cameras now than when dark ran"):
        go(request_, dataset=FakeDataset(shift=0.1))


def test_unknown_names_stop_before_any_work(request_: RunRequest) -> None:
    with pytest.raises(Unknown, match="did you mean 'bright'"):
        go(request_, metrics=("brigth",))
    with pytest.raises(Unknown, match="did you mean 'light'"):
        go(request_, methods=("lihgt",))
    assert not CALLS
    assert not request_.out.exists()


def test_run_json_adds_up_in_registered_order(request_: RunRequest) -> None:
    go(request_, scenes=("b",), methods=("light",), metrics=("covered",), command="first")
    go(request_, scenes=("a",), methods=("dark",), metrics=("bright",), command="second")
    run = json.loads((request_.out / "run.json").read_text())
    assert (run["scenes"], run["methods"]) == (["a", "b"], ["dark", "light"])
    assert run["metrics"] == ["bright", "covered"]
    assert run["commands"] == ["first", "second"]
    assert run["identity"]["preset"] == "draft"
    assert run["metric_specs"]["covered"]["higher_is_better"] is False


def test_the_work_folder_of_a_method_is_empty_at_its_start(request_: RunRequest) -> None:
    folder = RunStore(request_.out).fresh_work_dir("dark", "a")
    (folder / "old").write_text("stale")
    go(request_, scenes=("a",))
    assert not folder.exists()  # nothing was put into it
    SWITCHES["version"] = "2"
    SWITCHES["dark a"] = "leave a file"
    go(request_, scenes=("a",))
    assert [path.name for path in folder.iterdir()] == ["scene.safetensors"]
