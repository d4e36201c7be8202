"""The matrix of stability: judging outputs, cases, rows that are kept, tables."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench.adapters import MethodOutput
from bench.adapters.adapter import RunOptions
from bench.adapters.warp import WARP_TELEA
from bench.cli import main
from bench.report.stability import CLASSES, read_stability
from bench.stability.catalogue import CASES, choose_cases, find_case
from bench.stability.job import CaseJob, _complaint
from bench.stability.known import KNOWN_ROWS
from bench.stability.outcome import (
    CRASH,
    DEGRADED,
    EXACT,
    OUT_OF_MEMORY,
    OUTCOMES,
    SILENT_WRONG,
    TYPED,
    Verdict,
    failed,
    judge,
)
from bench.stability.rows import StabilityRows
from bench.stability.scenes import make_scene
from bench.stability.table import matrix_csv, matrix_table, totals
from bench.stability.worker import Limits, Report
from orca.errors import BadInput, Unavailable, Unknown

SCENE = make_scene()
VIEWS = len(SCENE.eval_indices)
SHAPE = (VIEWS, *SCENE.image.shape[:2])


def output(**changes: object) -> MethodOutput:
    """A faultless output."""
    frames = np.repeat(SCENE.image[None], VIEWS, 0)
    whole = MethodOutput(
        frames=frames,
        coverage=np.ones(SHAPE, np.float32),
        input_view=SCENE.image,
        frame_depth=np.ones(SHAPE, np.float32),
    )
    return replace(whole, **changes)  # type: ignore[arg-type]


def covered(share: float) -> np.ndarray:
    """Coverage with a share of holes, in whole rows."""
    alpha = np.ones(SHAPE, np.float32)
    alpha[:, : round(share * SHAPE[1])] = 0
    return alpha


def test_a_faultless_output_is_exact() -> None:
    verdict = judge(SCENE, output())
    assert (verdict.outcome, verdict.detail) == (EXACT, "")
    assert verdict.numbers == {"holes": 0.0, "input_psnr": 99.0}


def test_holes_in_silence_are_wrong_and_holes_that_are_told_degrade() -> None:
    open_views = covered(10 / 128)
    silent = judge(SCENE, output(coverage=open_views))
    assert (silent.outcome, silent.detail) == (SILENT_WRONG, "7.8% holes, and no word about them")
    told = judge(SCENE, output(coverage=open_views, notes=("7.8% of all pixels are holes",)))
    assert (told.outcome, told.detail) == (DEGRADED, "7.8% holes, and says so")


def test_views_of_what_the_input_never_showed_are_invented() -> None:
    away = find_case("turns-round").scene
    assert away is not None
    case = away(Path())
    views = (len(case.eval_indices), *case.image.shape[:2])
    made_up = MethodOutput(
        frames=np.zeros((*views, 3), np.uint8),
        coverage=np.ones(views, np.float32),
        input_view=case.image,
        frame_depth=np.ones(views, np.float32),
    )
    verdict = judge(case, made_up)
    assert verdict.outcome == DEGRADED
    assert "is invented: the input never showed it" in verdict.detail
    nothing = replace(made_up, coverage=np.zeros(views, np.float32), notes=("all holes",))
    assert "invented" not in judge(case, nothing).detail


def test_one_percent_of_holes_is_allowed() -> None:
    assert judge(SCENE, output(coverage=covered(1 / 128))).outcome == EXACT  # 0.8 %
    assert judge(SCENE, output(coverage=covered(2 / 128))).outcome == SILENT_WRONG  # 1.6 %


def test_nan_is_wrong() -> None:
    alpha, depth = covered(0), np.ones(SHAPE, np.float32)
    alpha[0, 0, 0] = np.nan
    assert judge(SCENE, output(coverage=alpha)).outcome == SILENT_WRONG
    depth[0, 5, 5] = np.nan
    assert "NaN depth" in judge(SCENE, output(frame_depth=depth)).detail
    alpha = covered(0)
    alpha[0, 5, 5] = 0  # where nothing is, no depth is needed
    assert judge(SCENE, output(frame_depth=depth, coverage=alpha)).outcome == EXACT


def test_a_view_that_is_covered_without_a_point_in_it_is_wrong() -> None:
    depth = np.ones(SHAPE, np.float32)
    depth[1] = np.inf
    assert (
        judge(SCENE, output(frame_depth=depth)).detail
        == f"1 of {VIEWS} views count as covered, and no point is in them"
    )
    depth[1, :64] = 1
    painted = judge(SCENE, output(frame_depth=depth))
    assert (painted.outcome, painted.detail) == (DEGRADED, "10.0% painted in, without geometry")


def test_what_was_lost_of_the_input_counts() -> None:
    lossy = judge(SCENE, output(input_view=np.asarray(255 - SCENE.image)))
    assert lossy.outcome == DEGRADED
    assert lossy.detail.startswith("input view ")
    assert judge(SCENE, output(input_view=None)).outcome == EXACT


def test_a_fallback_is_a_loss() -> None:
    verdict = judge(SCENE, output(notes=("fallback: repaired locally", "a remark")))
    assert (verdict.outcome, verdict.detail) == (DEGRADED, "repaired locally")


def test_wrong_shapes_and_complaints_are_wrong() -> None:
    assert judge(SCENE, output(frames=output().frames[:2])).outcome == SILENT_WRONG
    assert judge(SCENE, output(), "all views are green") == Verdict(
        SILENT_WRONG, "all views are green", {"holes": 0.0, "input_psnr": 99.0}
    )


def test_errors_become_outcomes() -> None:
    assert failed(BadInput("a\n  thing", "b", "c"), "method") == Verdict(TYPED, "a thing")
    assert failed(ValueError("x"), "load") == Verdict(CRASH, "ValueError: x (in load)")
    assert failed(MemoryError("x"), "method").outcome == OUT_OF_MEMORY
    assert failed(RuntimeError("DefaultCPUAllocator: can't allocate memory"), "method").outcome == OUT_OF_MEMORY
    assert failed(SystemExit(3), "method").outcome == CRASH


def test_the_catalogue() -> None:
    names = [case.name for case in CASES]
    assert len(names) == len(set(names)) >= 40
    for case in CASES:
        assert (case.scene is None) != (case.command is None), case.name
        assert set(case.expected) <= set(OUTCOMES) - {CRASH, SILENT_WRONG}, case.name
        assert case.expected, case.name
        assert case.takes("orca"), case.name
    groups = {case.group for case in CASES}
    assert groups == {"image", "files", "depth", "cameras", "priors", "command line", "machine", "photographs"}


@pytest.mark.parametrize("name", [case.name for case in CASES if case.scene and not case.needs])
def test_a_generated_scene_is_made_or_refused(name: str, tmp_path: Path) -> None:
    """Every input can be made without a method; only those that are to be refused may refuse already here."""
    case = find_case(name)
    assert case.scene is not None
    try:
        frames = len(case.scene(tmp_path).eval_indices)
    except (BadInput, Unavailable):
        frames = 0
    assert frames >= 1 or case.expected == (TYPED,)


def test_cases_are_chosen_by_name_and_group() -> None:
    chosen, left_out = choose_cases(["black,machine"])
    assert [case.name for case in chosen] == ["black", "full-disk", "short-of-memory"]
    assert left_out == ()
    with pytest.raises(Unknown, match="did you mean 'black'"):
        choose_cases(["blakc"])


def test_photographs_that_are_not_here_are_left_out(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("ORCA_DATA_ROOT", str(tmp_path))
    chosen, left_out = choose_cases(["photographs"])
    assert [case.name for case in chosen] == ["photos-rocket"]
    assert len(left_out) == 5


@pytest.mark.parametrize(
    ("case", "outcome", "words"),
    [
        ("constant-grey", DEGRADED, "holes, and says so"),
        ("zero-depth", DEGRADED, "100.0% holes, and says so"),
        ("wrong-size-depth", TYPED, "depth of shape (64, 64)"),
        ("huge-header", TYPED, "huge.png"),
        ("truncated-file", TYPED, "'cut.png' cannot be decoded"),
        ("unicode-name", DEGRADED, "holes"),
        ("mirrored-pose", TYPED, "determinant -1"),
        ("no-baseline", EXACT, ""),
    ],
)
def test_the_warp_on_some_cases(case: str, outcome: str, words: str) -> None:
    verdict = CaseJob(case, "warp").run().verdict
    assert verdict.outcome == outcome
    assert words in verdict.detail
    assert "/tmp" not in verdict.detail


@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "outcome", "words"),
    [
        ("black", EXACT, ""),
        ("smallest", DEGRADED, "input view"),
        ("one-camera", EXACT, ""),
        ("far-outlier", EXACT, ""),
        ("looks-away", DEGRADED, "holes, and says so"),
        ("outpainter-nan", DEGRADED, "the image is mirrored beyond the frame instead"),
        ("nan-patch", TYPED, "are NaN, infinite"),
        ("stretched-pose", TYPED, "a pose whose rotation R"),
    ],
)
def test_orca_itself_on_some_cases(case: str, outcome: str, words: str) -> None:
    """Never a crash, never a wrong output without a word; and the very outcome that the catalogue tells of."""
    verdict = CaseJob(case, "orca").run().verdict
    assert verdict.outcome not in (CRASH, SILENT_WRONG, OUT_OF_MEMORY), verdict.detail
    assert (verdict.outcome, words in verdict.detail) == (outcome, True), verdict.detail
    assert outcome in find_case(case).expected


def test_telea_does_not_claim_to_fill_from_nothing() -> None:
    scene = find_case("zero-depth").scene(Path())  # type: ignore[misc]
    filled = WARP_TELEA.run(scene, RunOptions())
    assert filled.coverage is not None
    assert filled.coverage.max() == 0
    assert judge(scene, filled).outcome == DEGRADED


def test_vistadreams_failure_is_that_of_numpy() -> None:
    """The row of VistaDream says IndexError: so does numpy for the expression in its code."""
    row = KNOWN_ROWS[0]
    assert (row["case"], row["outcome"], row["measured"]) == ("all-sky", CRASH, False)
    assert "ops/legos/inpaints/sky.py" in row["detail"]
    depth, sky = np.ones((4, 4)), np.ones((4, 4), bool)
    with pytest.raises(IndexError):
        np.percentile(depth[~sky], 95)


def report(outcome: str, detail: str = "") -> Report:
    return Report(Verdict(outcome, detail, {"holes": 0.0}), 1.0, 0.5, 100.0)


def test_rows_are_kept_and_not_done_again(tmp_path: Path) -> None:
    case, limits = find_case("all-sky"), Limits(10, 100)
    rows = StabilityRows(tmp_path)
    assert not rows.finished(case, "warp", "v1", limits)
    rows.add(case, "warp", "v1", limits, report(EXACT))
    rows.add(case, "orca", "v1", limits, report(OUT_OF_MEMORY))
    again = StabilityRows(tmp_path)
    assert again.finished(case, "warp", "v1", Limits(99, 999))
    assert not again.finished(case, "warp", "v2", limits)
    assert again.finished(case, "orca", "v1", limits)
    assert not again.finished(case, "orca", "v1", Limits(99, 999)), "more memory, another try"
    shown = {row["method"]: row for row in again.rows()}
    assert shown["warp"]["as_expected"] is True
    assert shown["orca"]["as_expected"] is False
    assert shown["vistadream"]["measured"] is False
    json.loads((tmp_path / "stability.json").read_text())["rows"]


def test_a_broken_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "stability.json").write_text('{"rows": [{"case": 1}]}')
    with pytest.raises(BadInput, match="broken row"):
        StabilityRows(tmp_path)


def test_tables_count_what_was_measured(tmp_path: Path) -> None:
    rows = StabilityRows(tmp_path)
    limits = Limits()
    rows.add(find_case("all-sky"), "warp", "v", limits, report(EXACT))
    rows.add(find_case("black"), "warp", "v", limits, report(CRASH, "ValueError: no, |really|"))
    found = rows.rows()
    assert totals(found, "warp") == "2 cases: 1 exact, 1 crash"
    assert totals(found, "vistadream") == "not run here"
    text = matrix_table(found).to_text()
    assert "crash !" in text
    assert "crash*" in text
    assert "black, warp: expected exact or degraded or typed failure; ValueError: no" in text
    assert '"ValueError: no, |really|"' in matrix_csv(found)
    assert len(matrix_csv(found).splitlines()) == 4


def test_the_report_page_reads_the_rows(tmp_path: Path) -> None:
    assert set(OUTCOMES) <= set(CLASSES)
    rows = StabilityRows(tmp_path)
    rows.add(find_case("all-sky"), "warp", "v", Limits(), report(EXACT))
    page = read_stability(rows.path)
    assert page["methods"] == ["warp", "vistadream"]
    assert [cell["class"] for cell in page["rows"][0]["cells"]] == ["good", "bad"]


@pytest.mark.slow
def test_the_verb(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["stability", "--methods", "warp", "--cases", "no-baseline,no-images", "--out", str(tmp_path), "--json"]
    assert main(words) == 0
    document = json.loads(capsys.readouterr().out)
    assert [(row["case"], row["outcome"]) for row in document["rows"]] == [
        ("no-images", TYPED),
        ("no-baseline", EXACT),
    ]
    assert document["unexpected"] == 0
    picture = tmp_path / "stability.png"
    assert picture.read_bytes()[:4] == b"\x89PNG"
    before = (tmp_path / "stability.json").stat().st_mtime_ns
    assert main(words) == 0
    assert (tmp_path / "stability.json").stat().st_mtime_ns == before, "nothing was computed again"


def test_the_verb_refuses_nonsense(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["stability", "--time-limit", "0"]) == 2
    assert main(["stability", "--cases", "blakc"]) == 2
    assert main(["stability", "--methods", "wrap"]) == 2
    assert "did you mean 'warp'" in capsys.readouterr().err


def test_a_complaint_of_the_command_line_is_told_without_its_progress_bars() -> None:
    text = "growth:  0%|    | 0/4096\rplanar fit: 100%|####| 1/1\norca: cannot write\nallowed: room\nto do: free some\n"
    assert _complaint(text) == "orca: cannot write allowed: room to do: free some"
    assert _complaint("Traceback: no word of ours") == "Traceback: no word of ours"
