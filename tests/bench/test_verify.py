"""A run that was touched, or whose inputs changed, is found, and the fault names the file."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import bench.verify as verify_module
from bench.cli import main
from bench.measured import read_runs
from bench.runner import RunRequest, run_bench
from bench.store import RunStore
from bench.verify import Verification, verify_run
from orca.errors import BadInput
from tests.bench import spine_fakes as fakes
from tests.bench.spine_fakes import FakeDataset

FIXTURES = Path(__file__).parent / "fixtures"


@pytest.fixture(autouse=True)
def _fresh(monkeypatch: pytest.MonkeyPatch) -> None:
    fakes.reset()
    monkeypatch.setattr(verify_module, "open_dataset", lambda name, **_: FakeDataset())


@pytest.fixture
def run_folder(tmp_path: Path) -> Path:
    """A copy of the stored run of the present schema version."""
    return Path(shutil.copytree(FIXTURES / "run_v2", tmp_path / "run"))


def edit(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document, indent=1))


def faults(found: Verification) -> list[tuple[str, str]]:
    return [(fault.file, fault.kind) for fault in found.faults]


def test_an_untouched_run_stands(run_folder: Path) -> None:
    found = verify_run(run_folder)
    assert (found.faults, found.notes) == ((), ())
    assert (found.records, found.inputs) == (4, 2)


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d["scores"]["bright"].update(value=99.0),
        lambda d: d["scores"]["bright"]["per_frame"].__setitem__(0, 11.0),
        lambda d: d["scores"].pop("covered"),
        lambda d: d["scores"]["bright"]["spec"].update(variant="median"),
        lambda d: d["timing"]["phases"].update(fit=0.1),
        lambda d: d["host"].update(cores=64),
        lambda d: d.update(notes=["new"]),
        lambda d: d["timing"].pop("digest"),
    ],
    ids=["value", "frame value", "score gone", "spec", "seconds", "host", "note", "seal of timing"],
)
def test_any_edit_of_a_result_is_found_and_the_file_named(
    run_folder: Path, change: Callable[[dict[str, Any]], object]
) -> None:
    path = run_folder / "scenes" / "dark" / "a.json"
    edit(path, change)
    assert faults(verify_run(run_folder)) == [(str(path), "edited")]


def test_an_edit_of_layout_only_is_none(run_folder: Path) -> None:
    path = run_folder / "scenes" / "dark" / "a.json"
    path.write_text(json.dumps(dict(reversed(json.loads(path.read_text()).items()))))
    assert verify_run(run_folder).faults == ()


def test_an_edited_result_marks_the_table(run_folder: Path) -> None:
    path = run_folder / "scenes" / "dark" / "a.json"
    edit(path, lambda d: d["scores"]["bright"].update(value=99.0))
    assert f"NOT AS MEASURED: {path} was changed after it was written (bench verify)" in read_runs([run_folder]).caption


def test_an_edited_run_json_is_found(run_folder: Path) -> None:
    edit(run_folder / "run.json", lambda d: d["identity"].update(seed=7))
    assert faults(verify_run(run_folder)) == [(str(run_folder / "run.json"), "edited")]


def test_a_result_of_another_cell_is_found(run_folder: Path) -> None:
    shutil.copy(run_folder / "scenes/light/a.json", run_folder / "scenes/dark/a.json")
    assert faults(verify_run(run_folder)) == [(str(run_folder / "scenes/dark/a.json"), "edited")]


@pytest.mark.parametrize(
    ("damage", "kind"),
    [
        (lambda p: p.unlink(), "missing"),
        (lambda p: p.write_bytes(b"no archive"), "frames"),
        (lambda p: shutil.copy(p.parents[1] / "light" / "a.npz", p), "frames"),
    ],
)
def test_other_frames_are_found(run_folder: Path, damage: Callable[[Path], object], kind: str) -> None:
    path = run_folder / "frames" / "dark" / "a.npz"
    damage(path)
    assert faults(verify_run(run_folder)) == [(str(path), kind)]


def test_another_input_view_beside_the_right_frames_is_found(run_folder: Path) -> None:
    mine, other = run_folder / "frames/dark/a.npz", run_folder / "frames/dark/b.npz"
    with np.load(mine) as a, np.load(other) as b:
        np.savez(mine.with_suffix(""), **{**a, "input_view": b["input_view"]})
    found = verify_run(run_folder)
    assert faults(found) == [(str(mine), "frames")]
    assert "input_view" in found.faults[0].what
    assert verify_run(run_folder, frames=False).faults == ()


def test_other_cameras_are_found(run_folder: Path) -> None:
    path = next((run_folder / "trajectories").glob("*.json"))
    edit(path, lambda d: d["world_to_camera"][3][0].__setitem__(3, 0.5))
    assert set(faults(verify_run(run_folder))) == {(str(path), "cameras")}
    path.unlink()
    assert set(faults(verify_run(run_folder))) == {(str(path), "missing")}


@pytest.mark.parametrize("content", ["", "[]", '{"schema_version": 3}', '{"schema_version": 2, "scores": 1}'])
def test_a_broken_file_is_a_fault_and_the_rest_is_checked(run_folder: Path, content: str) -> None:
    (run_folder / "scenes/dark/a.json").write_text(content)
    edit(run_folder / "scenes/light/b.json", lambda d: d["scores"]["bright"].update(value=1.0))
    assert faults(verify_run(run_folder)) == [
        (str(run_folder / "scenes/dark/a.json"), "unreadable"),
        (str(run_folder / "scenes/light/b.json"), "edited"),
    ]


def test_an_input_that_changed_is_stale_for_every_method(run_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(verify_module, "open_dataset", lambda name, **_: FakeDataset(shift=0.2))
    found = verify_run(run_folder)
    assert len(found.faults) == 4
    assert all(f.kind == "stale" and "the trajectory of scene" in f.what for f in found.faults)
    monkeypatch.setattr(verify_module, "open_dataset", lambda name, **_: FakeDataset(broken=frozenset("b")))
    assert [f.file for f in verify_run(run_folder).faults] == ["scene b of fake"]


def test_the_stale_input_file_itself_is_named(tmp_path: Path) -> None:
    images, out = tmp_path / "images", tmp_path / "out"
    images.mkdir()
    (images / "a.png").write_bytes(b"as it was")
    (images / "ab.png").write_bytes(b"another scene")
    request = RunRequest(FakeDataset(), ("a",), ("dark",), ("bright",), out, images=images)
    run_bench(request, methods=fakes.METHODS, metrics=fakes.METRICS)
    record = RunStore(out).load("dark", "a")
    assert record is not None
    assert list(record.inputs["files"]) == ["a.png"]
    assert verify_run(out).faults == ()
    (images / "ab.png").write_bytes(b"who cares")
    assert verify_run(out).faults == ()
    (images / "a.png").write_bytes(b"as it was not")
    assert faults(verify_run(out)) == [(str(images / "a.png"), "stale")]
    (images / "a.png").unlink()
    assert faults(verify_run(out)) == [(str(images / "a.png"), "stale")]


def test_a_failed_cell_without_frames_is_no_fault(tmp_path: Path) -> None:
    fakes.SWITCHES["dark a"] = "crash"
    request = RunRequest(FakeDataset(), ("a",), ("dark",), ("bright",), tmp_path / "out")
    run_bench(request, methods=fakes.METHODS, metrics=fakes.METRICS)
    assert verify_run(tmp_path / "out").faults == ()


def test_a_run_of_schema_version_1_loads_and_says_what_cannot_be_checked() -> None:
    root = FIXTURES / "run_v1"
    run = RunStore(root).load_run()
    assert run is not None
    assert (run["schema_version"], run["identity"]["codec"]) == (2, None)
    assert run["timing"]["started"].startswith("2026-")
    measured = read_runs([root])
    assert measured.value("warp-telea", "motorcycle", "psnr").number == pytest.approx(23.6, abs=0.05)
    found = verify_run(root)
    assert found.notes[0].startswith("3 files without a seal")
    assert {kind for _, kind in faults(found)} == {"missing"}  # the fixture has no frames and no cameras


def test_a_run_of_schema_version_2_loads() -> None:
    root = FIXTURES / "run_v2"
    run = RunStore(root).load_run()
    assert run is not None
    assert run["data"]["scenes"]["a"]["image"].startswith("a47f")
    assert read_runs([root]).value("light", "a", "bright").number == pytest.approx(201, abs=1)


def test_a_folder_without_a_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="no run in"):
        verify_run(tmp_path)


def test_the_command_exits_with_1_and_names_the_file(run_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["verify", str(run_folder)]) == 0
    assert "4 results, inputs of 2 scenes: as measured" in capsys.readouterr().out
    edit(run_folder / "scenes/dark/a.json", lambda d: d["scores"]["bright"].update(value=99.0))
    assert main(["verify", str(run_folder)]) == 1
    assert f"{run_folder / 'scenes/dark/a.json'}: edited: its content" in capsys.readouterr().out
    assert main(["verify", str(run_folder), "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["faults"][0]["kind"] == "edited"
