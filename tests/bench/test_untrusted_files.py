"""What a run, a data set or a method brings from elsewhere: refused before it costs anything, and never run."""

from __future__ import annotations

import ast
import hashlib
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import bench
import orca
from bench.cameras_io import read_camera_file
from bench.frames import frame_hashes, load_frames, save_frames, stored_precision
from bench.metrics.weights import WeightsFile
from bench.record import CellRecord
from bench.store import RunStore
from orca.errors import BadInput
from tests.bench.test_store import a_record, an_output
from tests.bench.test_weights import fetched, site

__all__ = ["site"]  # a fixture

SOURCES = sorted(
    path for package in (orca, bench) for path in Path(str(package.__file__)).parent.rglob("*.py") if path.is_file()
)


def test_stored_frames_hold_no_more_than_their_file(tmp_path: Path) -> None:
    output = stored_precision(an_output(np.random.default_rng(0)))
    record = CellRecord("d", "s", "m", "1", None, frames=frame_hashes(output.frames, (0, 1, 2)))
    path = tmp_path / "a.npz"
    save_frames(path, output)
    assert load_frames(path, record) is not None
    np.savez_compressed(path, frame_000000=np.zeros(10**8, np.uint8))  # 100 kB that become 100 MB
    assert load_frames(path, record) is None
    np.save(tmp_path / "b.npy", np.zeros(3))
    (tmp_path / "b.npy").rename(path)
    assert load_frames(path, record) is None


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("method", 3),
        ("timing", []),
        ("notes", [None]),
        ("model", "large"),
        ("scores", {"m": {"value": "9e9", "n": 1, "reason": None, "status": "ok", "spec": {}}}),
        ("scores", {"m": {"value": True, "n": 1, "reason": None, "status": "ok", "spec": {}}}),
        ("scores", {"m": {"value": 1.0, "n": None, "reason": None, "status": "ok", "spec": {}}}),
        ("scores", {"m": {"value": 1.0, "n": 1, "reason": None, "status": "splendid", "spec": {}}}),
        ("frames", [{"index": 0, "pixel_sha256": "a", "run": "rm"}]),
    ],
)
def test_a_record_of_other_types(field: str, value: Any) -> None:
    document = json.loads(json.dumps(a_record().to_json()))
    assert CellRecord.from_json(document, "it") == a_record()
    with pytest.raises(BadInput, match="it is not a result"):
        CellRecord.from_json({**document, field: value}, "it")


def test_a_run_of_another_kind(tmp_path: Path) -> None:
    (tmp_path / "run.json").write_text("[" * 100_000)
    with pytest.raises(BadInput):
        RunStore(tmp_path).load_run()


@pytest.mark.parametrize("angle", [0, 3.2, -1, 1e308])
def test_a_field_of_view_that_is_none(tmp_path: Path, angle: float) -> None:
    frame = {"transform_matrix": np.eye(4).tolist()}
    path = tmp_path / "transforms.json"
    path.write_text(json.dumps({"w": 8, "h": 8, "camera_angle_x": angle, "frames": [frame]}))
    with pytest.raises(BadInput):
        read_camera_file(path)


def test_weights_are_those_that_their_hash_says(tmp_path: Path) -> None:
    """A pinned hash may be whole, or its first digits where no more is published."""
    content = b"weights"
    right = hashlib.sha256(content).hexdigest()
    (tmp_path / "net.pth").write_bytes(content)
    for digits in (right, right[:8], ""):
        WeightsFile("m", "net.pth", "https://x", digits).check(tmp_path)
    with pytest.raises(BadInput, match="begins with 00000000"):
        WeightsFile("m", "net.pth", "https://x", "00000000").check(tmp_path)


def test_fetched_weights_of_another_hash_are_not_kept(tmp_path: Path, site: str) -> None:
    (tmp_path / "site" / "net.pth").write_bytes(b"weights")
    state, why = fetched((WeightsFile("m", "net.pth", site, "00000000"),), tmp_path)[0]
    assert (state, "00000000" in why) == ("failed", True), why
    assert not list((tmp_path / "weights").glob("*.pth"))


def test_addresses_are_https_or_this_machine() -> None:
    """Every address in the code; servers are asked for over http on this machine only."""
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                text = node.value
                assert "0.0.0.0" not in text, path
                for where in re.findall(r"http://([\w.:]+)", text):
                    assert where.startswith(("127.0.0.1", "localhost", "host:8000", "www.w3.org")), (path, text)


def test_servers_listen_on_this_machine_unless_told() -> None:
    import inspect

    from orca.cli import build_parser
    from orca.view import SceneViewer

    given = build_parser().parse_args(["view", "scene.safetensors"])
    assert given.host == "127.0.0.1"
    assert inspect.signature(SceneViewer).parameters["host"].default == "127.0.0.1"


def test_nothing_unpickles_or_evaluates() -> None:
    """The one unpickler is the restricted one, torch.load reads tensors only, and there is no shell and no eval."""
    banned = {
        "pickle.load",
        "pickle.loads",
        "pickle.Unpickler",
        "os.system",
        "eval",
        "exec",
        "yaml.load",
        "joblib.load",
    }
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call):
                continue
            name, keywords = ast.unparse(node.func), {key.arg: ast.unparse(key.value) for key in node.keywords}
            own = name == "pickle.loads" and ast.unparse(node.args[0]).startswith("pickle.dumps(")
            assert own or name not in banned, (path, node.lineno, name)
            assert name not in ("torch.load",) or keywords.get("weights_only") == "True", (path, node.lineno)
            assert name not in ("np.load", "numpy.load") or keywords.get("allow_pickle", "False") == "False", path
            assert keywords.get("shell") in (None, "False"), (path, node.lineno)
