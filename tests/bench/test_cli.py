"""The command line: exit codes, one JSON document, three-line errors, and a help that costs nothing."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import bench.commands.run as run_verb
from bench.adapters import METHODS
from bench.cli import main
from bench.commands.list import METHOD_DESCRIPTIONS, METRIC_DESCRIPTIONS
from bench.metrics import METRICS
from tests.bench import spine_fakes as fakes
from tests.bench.spine_fakes import CALLS, SWITCHES, FakeDataset

REPO = Path(__file__).parents[2]


@pytest.fixture
def fake_bench(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[str]:
    """The run verb on fake scenes and methods; the arguments that make it write into a temporary folder."""
    fakes.reset()
    monkeypatch.setattr(run_verb, "open_dataset", lambda name, **_: FakeDataset())
    monkeypatch.setattr(run_verb, "METHODS", fakes.METHODS)
    monkeypatch.setattr(run_verb, "METRICS", fakes.METRICS)
    real = run_verb.run_bench

    def run_bench(request: Any, reporter: Any, executor: Any) -> Any:
        return real(request, reporter, fakes.METHODS, fakes.METRICS, executor)

    monkeypatch.setattr(run_verb, "run_bench", run_bench)
    return ["run", "--out", str(tmp_path / "out"), "--metrics", "bright,covered"]


def error_lines(capsys: pytest.CaptureFixture[str], argv: list[str]) -> list[str]:
    assert main(argv) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    return captured.err.strip().splitlines()


def test_run_ends_in_tables_and_the_paths_of_what_it_wrote(
    fake_bench: list[str], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(fake_bench) == 0
    out = capsys.readouterr().out
    assert "fake: every scene" in out
    assert "fake: mean over 3 scenes" in out
    assert "9 cells computed, 0 finished before" in out
    for name in ("dataset.md", "dataset.csv", "scenes.md", "scenes.csv"):
        assert f"wrote {tmp_path / 'out' / 'tables' / name}" in out
        assert (tmp_path / "out" / "tables" / name).is_file()


def test_json_is_one_document_even_when_a_library_prints(
    fake_bench: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    load = FakeDataset.load

    def chatty(self: FakeDataset, scene: str) -> Any:
        print("downloading weights ...")
        return load(self, scene)

    monkeypatch.setattr(FakeDataset, "load", chatty)
    assert main([*fake_bench, "--json", "--scenes", "b", "--methods", "dark,light"]) == 0
    captured = capsys.readouterr()
    document = json.loads(captured.out)
    assert (document["computed"], document["skipped"], document["failed"]) == (2, 0, [])
    assert document["tables"]["dataset"]["rows"][0]["cells"]["bright"]["value"] == 11.0
    assert "downloading weights" in captured.err


def test_a_failed_cell_is_exit_code_1_now_and_on_the_rerun(
    fake_bench: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    SWITCHES["dark a"] = "crash"
    assert main(fake_bench) == 1
    assert main(fake_bench) == 1
    assert "0 cells computed, 9 finished before; failed: dark/a" in capsys.readouterr().out
    SWITCHES.clear()
    assert main([*fake_bench, "--retry-failed"]) == 0


def test_interrupt_is_exit_code_130(fake_bench: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    SWITCHES["light a"] = "interrupt"
    assert main(fake_bench) == 130
    assert "finished work is kept" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("extra", "words"),
    [
        (["--scenes", "a,bb"], "unknown scene 'bb'"),
        (["--methods", "drak"], "did you mean 'dark'?"),
        (["--metrics", "brigth"], "did you mean 'bright'?"),
        (["--preset", "drat"], "did you mean 'draft'?"),
        (["--scenes", ","], "an empty list of names"),
        (["--device", "tpu"], "device 'tpu'"),
        (["--weights-dir", "nowhere"], "--weights-dir nowhere"),
    ],
)
def test_bad_input_is_three_lines_and_exit_code_2_before_any_work(
    fake_bench: list[str], capsys: pytest.CaptureFixture[str], tmp_path: Path, extra: list[str], words: str
) -> None:
    lines = error_lines(capsys, [*fake_bench, *extra])
    assert len(lines) == 3
    assert lines[0].startswith("error: ")
    assert lines[1].startswith("  allowed: ")
    assert lines[2].startswith("  to do:   ")
    assert words in "\n".join(lines)
    assert not CALLS
    assert not (tmp_path / "out").exists()


def test_a_changed_seed_is_refused_by_name(fake_bench: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(fake_bench) == 0
    capsys.readouterr()
    lines = error_lines(capsys, [*fake_bench, "--seed", "1"])
    assert "a run with seed 0; this one has seed 1" in lines[0]


def test_an_error_with_json_is_a_document_too(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "--dataset", "photo", "--json"]) == 2
    error = json.loads(capsys.readouterr().out)["error"]
    assert error["kind"] == "unknown_name"
    assert error["fix"] == "did you mean 'photos'?"


def test_debug_shows_the_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    lines = error_lines(capsys, ["table", "nowhere", "--debug"])
    assert lines[0].startswith("Traceback")


def test_table_reads_files_only(fake_bench: list[str], capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(fake_bench) == 0
    CALLS.clear()
    capsys.readouterr()
    assert main(["table", str(tmp_path / "out")]) == 0
    assert "fake: every scene" in capsys.readouterr().out
    assert not CALLS
    assert main(["table", str(tmp_path / "out"), "--json"]) == 0
    assert set(json.loads(capsys.readouterr().out)["tables"]) == {"dataset", "scenes"}


def test_table_wants_a_run_or_the_paper_or_both(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert "no run to print" in error_lines(capsys, ["table"])[0]
    assert "no run in" in error_lines(capsys, ["table", str(tmp_path), "--published"])[0]


def test_published_tables_are_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["table", "--published"]) == 0
    out = capsys.readouterr().out
    assert all(number in out for number in ("68.7133", "75.9137", "0.9980"))
    assert main(["table", "--published", "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["tables"]) == 3


@pytest.mark.parametrize("what", ["datasets", "methods", "metrics", "trajectories", "scenes"])
def test_list_names_everything(what: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", what, "--json"]) == 0
    items = json.loads(capsys.readouterr().out)[what]
    assert items
    assert what == "scenes" or all(item["description"] for item in items)
    assert main(["list", what]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == [item["name"] for item in items]


def test_every_method_and_metric_has_a_description_and_no_other() -> None:
    assert set(METHOD_DESCRIPTIONS) == set(METHODS)
    assert set(METRIC_DESCRIPTIONS) == set(METRICS)


def test_default_methods_fit_the_data_set() -> None:
    assert run_verb.default_methods("photos") == ("orca", "orca-paper", "warp", "warp-telea")
    only_synthetic = {"orca-norepair", "orca-plainfill", "warp-nearest"}
    assert run_verb.default_methods("realmdreamer") == tuple(name for name in METHODS if name not in only_synthetic)
    assert only_synthetic <= set(run_verb.default_methods("synthetic"))


def test_weights_are_looked_for_beside_the_data(tmp_path: Path) -> None:
    assert run_verb._weights_dir(None, tmp_path) is None
    (tmp_path / "weights").mkdir()
    assert run_verb._weights_dir(None, tmp_path) == tmp_path / "weights"
    assert run_verb._weights_dir(tmp_path, tmp_path) == tmp_path


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys; from bench.cli import main\n"
        "try: main(['--help'])\nexcept SystemExit: pass\n"
        "heavy = {'numpy', 'torch', 'cv2', 'pandas', 'tqdm', 'skimage'} & set(sys.modules)\n"
        "sys.exit(str(heavy) if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=REPO, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "run" in done.stdout


@pytest.mark.parametrize("argv", [["list", "metrics"], ["list", "methods"], ["table", "--published"]])
def test_light_verbs_do_not_import_torch(argv: list[str]) -> None:
    code = f"import sys; from bench.cli import main; main({argv!r}); sys.exit('torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], cwd=REPO, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
