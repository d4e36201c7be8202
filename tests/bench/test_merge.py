"""Merging: the laws of the join, and files: no order, no repetition and no grouping of runs makes a difference."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.cli import main
from bench.digest import broken_seals, sealed
from bench.join import Conflict, canonical, joined_records, joined_runs
from bench.measured import read_runs
from bench.merge import Merged, merge_runs
from bench.record import CellRecord, Failure, ScoreRecord, StoredFrame
from bench.runner import run_bench
from bench.shard import scenes_of_shard
from bench.store import RunStore, read_json, write_json
from bench.verify import verify_run
from orca.errors import BadInput
from tests.bench.run_files import lasting
from tests.bench.worker_fakes import METHODS, METRICS, request_of

# --- the laws ---

_SPEC = {"id": "m", "title": "M", "variant": "v", "version": "1", "weights_sha256": None}
_SCORES = st.builds(
    lambda status, value: ScoreRecord(
        value if status == "ok" else None, 1, None if status == "ok" else f"{status} {value}", status, _SPEC
    ),
    st.sampled_from(["ok", "not_applicable", "unavailable", "failed"]),
    st.sampled_from([1.0, 2.0]),
)
_FAILURES = st.builds(lambda given: Failure("crash", {"given": given}, "fit"), st.sampled_from(["x", "y"]))


@st.composite
def records(draw: st.DrawFn) -> CellRecord:
    """Records of one cell with so few values that any two often agree, and often contradict each other."""
    return CellRecord(
        "data",
        "scene",
        "method",
        draw(st.sampled_from(["1"] * 9 + ["2"])),
        "ab",
        scores=draw(st.dictionaries(st.sampled_from("pqr"), _SCORES, max_size=3)),
        frames=(StoredFrame(0, draw(st.sampled_from(["f"] * 9 + ["g"]))),),
        inputs={"image": "i", "files": draw(st.dictionaries(st.sampled_from("mn"), st.just("h"), max_size=2))},
        timing={
            "wall_s": draw(st.sampled_from([1.0, 2.0])),
            "metrics": draw(st.dictionaries(st.sampled_from("PQ"), st.sampled_from([0.1, 0.2]), max_size=2)),
        },
        host={"cpu": draw(st.sampled_from(["fast", "slow"]))},
        failure=draw(st.none() | _FAILURES),
    )


def joined(*parts: CellRecord | None) -> CellRecord | None:
    """The join of all, None standing for a contradiction, which stays one whatever is joined to it."""
    result = parts[0]
    for part in parts[1:]:
        try:
            result = None if result is None or part is None else joined_records(result, part)
        except Conflict:
            return None
    return result


def text(record: CellRecord | None) -> str:
    return "conflict" if record is None else canonical(record)


@settings(max_examples=100, deadline=None)
@given(records(), records(), records())
def test_the_join_is_associative_commutative_and_idempotent(a: CellRecord, b: CellRecord, c: CellRecord) -> None:
    assert text(joined(a, a)) == text(a)
    assert text(joined(a, b)) == text(joined(b, a))
    assert text(joined(joined(a, b), c)) == text(joined(a, joined(b, c)))
    assert text(joined(joined(a, b), b)) == text(joined(a, b))


@settings(max_examples=50, deadline=None)
@given(records(), records())
def test_the_join_loses_no_answer(a: CellRecord, b: CellRecord) -> None:
    both = joined(a, b)
    if both is None:
        return
    for part in (a, b):
        if part.failure is None:
            assert both.failure is None
            for key, score in part.scores.items():
                assert both.scores[key] == score or score.status in ("failed", "unavailable")


_NAMES = st.lists(st.sampled_from(["a", "b", "c"]), unique=True)


@st.composite
def runs(draw: st.DrawFn) -> dict[str, Any]:
    """Descriptions of runs that differ in everything that may differ."""
    versions = draw(st.dictionaries(st.sampled_from("mn"), st.sampled_from("12")))
    return {
        "identity": {"dataset": "d", "preset": "draft", "seed": draw(st.sampled_from([0] * 9 + [1]))},
        **{key: draw(_NAMES) for key in ("scenes", "methods", "metrics", "commands")},
        "method_versions": versions,
        "preset_config": draw(st.sampled_from([{}, {"k": 1}])),
        "argv": draw(st.lists(_NAMES, max_size=2)),
        "timing": draw(st.sampled_from([{}, {"started": "2026-01-01"}, {"started": "2026-01-02"}])),
        "host": draw(st.sampled_from([{}, {"cpu": "x"}, {"cpu": "y"}])),
        "code": draw(st.sampled_from([{}, {"commit": "1"}, {"commit": "2"}])),
    }


def _joined_runs(*parts: dict[str, Any] | None) -> dict[str, Any] | None:
    result = parts[0]
    for part in parts[1:]:
        try:
            result = None if result is None or part is None else joined_runs(result, part)
        except Conflict:
            return None
    return result


@settings(max_examples=50, deadline=None)
@given(runs(), runs(), runs())
def test_so_is_the_join_of_what_describes_a_run(a: dict[str, Any], b: dict[str, Any], c: dict[str, Any]) -> None:
    a, b, c = (joined_runs(run, run) for run in (a, b, c))
    assert _joined_runs(a, a) == a
    assert _joined_runs(a, b) == _joined_runs(b, a)
    assert _joined_runs(_joined_runs(a, b), c) == _joined_runs(a, _joined_runs(b, c))


# --- files ---


@pytest.fixture(scope="module")
def parts(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Path]]:
    """A whole run of six scenes, and the same in three shards, of which the last has an extra scene of the first."""
    folder = tmp_path_factory.mktemp("parts")
    whole = request_of(folder, "whole")
    run_bench(whole, None, METHODS, METRICS)
    shards = []
    for i in (1, 2, 3):
        mine = scenes_of_shard(whole.scenes, whole.scenes, (i, 3))
        request = replace(whole, scenes=mine + (("s00000",) if i == 3 else ()), out=folder / f"shard{i}")
        run_bench(request, None, METHODS, METRICS)
        shards.append(request.out)
    return whole.out, shards


def every_byte(run: Path) -> dict[str, bytes]:
    """Path -> content of every file that merging answers for."""
    files = (path for path in run.rglob("*") if path.is_file() and path.name not in (".lock", "scores.parquet"))
    return {str(path.relative_to(run)): path.read_bytes() for path in files}


def merge(out: Path, runs: list[Path]) -> Merged:
    return merge_runs(out, runs, METHODS, METRICS)


def copy(run: Path, to: Path) -> Path:
    shutil.copytree(run, to)
    return to


def edit(path: Path, change: Callable[[dict[str, Any]], None], seal: bool = True) -> None:
    document = read_json(path)
    change(document)
    write_json(path, sealed(document) if seal else document)


def test_shards_together_are_the_whole_run(parts: tuple[Path, list[Path]], tmp_path: Path) -> None:
    whole, shards = parts
    merged = merge(tmp_path / "out", shards)
    assert (merged.results, merged.several) == (12, 2)
    assert lasting(tmp_path / "out", ordered=False) == lasting(whole, ordered=False)
    assert (tmp_path / "out" / "scores.parquet").is_file()
    assert not broken_seals(read_json(tmp_path / "out" / "run.json"))
    assert verify_run(tmp_path / "out").faults == ()


def test_no_order_grouping_or_repetition_changes_a_byte(parts: tuple[Path, list[Path]], tmp_path: Path) -> None:
    a, b, c = parts[1]
    merge(tmp_path / "abc", [a, b, c])
    expected = every_byte(tmp_path / "abc")
    merge(tmp_path / "cba", [c, b, a, b])
    assert every_byte(tmp_path / "cba") == expected
    merge(tmp_path / "ab", [a, b])
    merge(tmp_path / "ab_c", [tmp_path / "ab", c])
    assert every_byte(tmp_path / "ab_c") == expected
    merge(tmp_path / "bc", [b, c])
    merge(tmp_path / "bc", [a])  # into a folder that holds a run already
    assert every_byte(tmp_path / "bc") == expected
    stamps = {path: path.stat().st_mtime_ns for path in (tmp_path / "abc" / "scenes").rglob("*.json")}
    merge(tmp_path / "abc", [tmp_path / "abc", a, b, c])
    assert every_byte(tmp_path / "abc") == expected
    assert stamps == {path: path.stat().st_mtime_ns for path in stamps}


def test_a_merged_run_goes_on_as_any_other(parts: tuple[Path, list[Path]], tmp_path: Path) -> None:
    request = request_of(tmp_path, "out")
    merge(request.out, parts[1][:2])
    assert run_bench(request, None, METHODS, METRICS).computed == 4


def test_two_values_for_one_score_are_an_error_that_names_both_files(
    parts: tuple[Path, list[Path]], tmp_path: Path
) -> None:
    other = copy(parts[1][0], tmp_path / "other")
    cell = Path("scenes/copy/s00000.json")
    edit(other / cell, lambda d: d["scores"]["grey"].update(value=99.0))
    with pytest.raises(BadInput, match=r"contradict each other: grey 0.0 .* and 99.0") as error:
        merge(tmp_path / "out", [parts[1][0], other])
    assert str(parts[1][0] / cell) in error.value.given
    assert str(other / cell) in error.value.given
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d.update(method_version="2"), "another method_version: 1 and 2"),
        (lambda d: d["frames"][0].update(pixel_sha256="0"), "another frames"),
        (lambda d: d["inputs"].update(image="0"), "another image as input"),
        (lambda d: d.update(trajectory_sha256="0"), "another trajectory_sha256"),
    ],
)
def test_other_code_or_other_data_is_a_contradiction(
    parts: tuple[Path, list[Path]], tmp_path: Path, change: Callable[[dict[str, Any]], None], words: str
) -> None:
    other = copy(parts[1][0], tmp_path / "other")
    edit(other / "scenes/copy/s00000.json", change)
    with pytest.raises(BadInput, match=words):
        merge(tmp_path / "out", [parts[1][0], other])


def test_another_run_is_refused_by_the_names_of_both(parts: tuple[Path, list[Path]], tmp_path: Path) -> None:
    other = copy(parts[1][1], tmp_path / "other")
    edit(other / "run.json", lambda d: d["identity"].update(seed=3))
    with pytest.raises(BadInput, match=r"shard1/run.json and .*other/run.json contradict each other: seed 0 and 3"):
        merge(tmp_path / "out", [parts[1][0], other])


def test_an_edited_file_and_a_folder_without_a_run_are_refused(parts: tuple[Path, list[Path]], tmp_path: Path) -> None:
    other = copy(parts[1][0], tmp_path / "other")
    edit(other / "scenes/copy/s00003.json", lambda d: d["scores"]["grey"].update(value=99.0), seal=False)
    with pytest.raises(BadInput, match=r"s00003\.json: its content is not what was written"):
        merge(tmp_path / "out", [other])
    with pytest.raises(BadInput, match="no run in"):
        merge(tmp_path / "out", [tmp_path / "nothing"])


def test_a_success_replaces_a_failure_and_scores_add_up(parts: tuple[Path, list[Path]], tmp_path: Path) -> None:
    good = parts[1][0]
    failed, fewer = copy(good, tmp_path / "failed"), copy(good, tmp_path / "fewer")
    lost = {"kind": "lost_worker", "message": {"given": "g"}, "phase": "method", "traceback": None}
    edit(failed / "scenes/copy/s00000.json", lambda d: d.update(failure=lost, scores={}, frames=[]))
    (failed / "frames/copy/s00000.npz").unlink()
    edit(fewer / "scenes/copy/s00003.json", lambda d: d["scores"].pop("size"))
    merge(tmp_path / "out", [failed, fewer])
    record = RunStore(tmp_path / "out").load("copy", "s00000")
    assert record is not None
    assert record.failure is None
    assert lasting(tmp_path / "out", ordered=False) == lasting(good, ordered=False)


def test_what_a_method_left_comes_from_the_run_whose_result_it_is(
    parts: tuple[Path, list[Path]], tmp_path: Path
) -> None:
    a, b = (copy(parts[1][0], tmp_path / name) for name in "ab")
    for run, seconds in ((a, 5.0), (b, 4.0)):
        edit(run / "scenes/copy/s00000.json", lambda d, s=seconds: d["timing"].update(wall_s=s))  # type: ignore[misc]
        (run / "work/copy/s00000/deep").mkdir(parents=True)
        (run / "work/copy/s00000/deep/made by").write_text(run.name)
    for order in ([a, b], [b, a]):
        out = tmp_path / "out"
        merge(out, order)
        record = RunStore(out).load("copy", "s00000")
        assert record is not None
        assert record.timing["wall_s"] == 4.0
        assert (out / "work/copy/s00000/deep/made by").read_text() == "b"
        shutil.rmtree(out)


def test_answers_and_cached_scores_come_together(parts: tuple[Path, list[Path]], tmp_path: Path) -> None:
    a, b = (copy(parts[1][0], tmp_path / name) for name in "ab")
    lines = [json.dumps({"asked_of": "m", "frame_sha256": str(i), "text": "t", "answer": "yes"}) for i in range(3)]
    for run, mine, torn in ((a, lines[:2], ""), (b, lines[1:], '{"asked_of": "m", "fra')):
        (run / "answers").mkdir()
        (run / "answers/llava.jsonl").write_text("\n".join([*mine, torn]))
    entry = next((a / "cache/scores").rglob("*.json"))
    entry.write_text("torn")
    kept = b / entry.relative_to(a)
    for order in ([a, b], [b, a]):
        merge(tmp_path / "out", order)
        assert (tmp_path / "out/answers/llava.jsonl").read_text().splitlines() == lines
        assert (tmp_path / "out" / entry.relative_to(a)).read_bytes() == kept.read_bytes()
        shutil.rmtree(tmp_path / "out")
    (b / "answers/llava.jsonl").write_text(lines[0].replace("yes", "no"))
    with pytest.raises(BadInput, match='answered "yes" and "no"'):
        merge(tmp_path / "out", [a, b])


def test_a_table_says_that_several_machines_were_timed(parts: tuple[Path, list[Path]], tmp_path: Path) -> None:
    other = copy(parts[1][1], tmp_path / "other")
    edit(other / "scenes/copy/s00001.json", lambda d: d["host"].update(cpu="another", cores=64, threads=8))
    merge(tmp_path / "out", [parts[1][0], other])
    notes = [line for line in read_runs([tmp_path / "out"]).caption if line.startswith("Timings are of 2 settings")]
    assert len(notes) == 1
    assert "another, 64 cores, 8 threads" in notes[0]
    assert not any("settings" in line for line in read_runs([parts[1][0]]).caption)


def test_the_command_line(parts: tuple[Path, list[Path]], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["merge", str(tmp_path / "out"), *map(str, parts[1]), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["results"], document["several"], len(document["runs"])) == (12, 2, 3)
    assert main(["merge", str(tmp_path / "out"), str(tmp_path)]) == 2
