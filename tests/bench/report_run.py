"""A small run on disk for the tests of the page: moving frames, a failure, a missing score, names that are markup."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from bench.adapters import MethodOutput
from bench.frames import frame_hashes, save_frames
from bench.metrics import MetricSpec, Score
from bench.record import CellRecord, Failure, ScoreRecord
from bench.store import RunStore
from orca.camera import Camera
from orca.conventions import UInt8Array
from orca.errors import Unavailable
from orca.images import save_image
from orca.repair.ledger import Ledger, RepairRecord, run_lengths
from orca.repair.rules import RepairRules
from tests.orca.test_orca_cli import small_scene

SCRIPT = "<script>pwned=1"
IMAGE = '"><img src=x onerror=pwned=1>'
SCENES = ("plain", SCRIPT, IMAGE)
METHODS = ("orca", "warp", "<b>bold")
FRAMES, WIDTH, HEIGHT = 12, 64, 48
SPECS = (
    MetricSpec("input_psnr", "PSNR, input view (dB)", True, (0, None), "all pixels", "1", 2),
    MetricSpec("niqe", "NIQE", False, (0, None), "usual", "1", 2),
    MetricSpec("musiq", "MUSIQ", True, (0, 100), "needs weights", "1", 2),
)


def moving_frames(method: int, scene: int) -> UInt8Array:
    """A bar that moves 4 pixels a frame to the right, in a colour of the method's, on a grey of the scene's."""
    frames = np.full((FRAMES, HEIGHT, WIDTH, 3), 40 + 50 * scene, np.uint8)
    for i, frame in enumerate(frames):
        frame[:, 4 * i : 4 * i + 8] = 60
        frame[:, 4 * i : 4 * i + 8, method] = 250
    return frames


def write_run(root: Path) -> Path:
    """Write the run into ``root / "run"`` with its images beside it; return its folder."""
    images = root / "images"
    for k, scene in enumerate(SCENES):
        image = np.full((HEIGHT, WIDTH, 3), 40 + 50 * k, np.uint8)
        image[10:30, 20:40] = (200, 120, 60)
        save_image(images / f"{scene}.png", image)
        depth = np.full((HEIGHT, WIDTH), 3.0, np.float32)
        depth[10:30, 20:40] = 1.0
        np.save(images / f"{scene}.depth.npy", depth)
    store = RunStore(root / "run")
    for k, scene in enumerate(SCENES):
        for m, method in enumerate(METHODS):
            _write_cell(store, method, m, scene, k)
    store.save_run(_run(images))
    return store.root


def write_stability(path: Path) -> Path:
    """Rows of every class, one of them with markup in every field."""
    rows = [
        {"case": "all sky", "method": "orca", "outcome": "degraded", "detail": "margin left empty", "seconds": 2.5},
        {"case": "all sky", "method": "warp", "outcome": "crash", "detail": "IndexError", "seconds": 0.1},
        {"case": SCRIPT, "method": "orca", "outcome": "exact", "detail": "", "seconds": 1},
        {"case": SCRIPT, "method": "warp", "outcome": "<i>odd</i>", "detail": IMAGE, "seconds": None},
    ]
    path.write_text(json.dumps({"rows": rows}))
    return path


def _write_cell(store: RunStore, method: str, m: int, scene: str, k: int) -> None:
    if method == "warp" and scene == SCRIPT:
        failure = Failure.of(IndexError(f"percentile of an empty array in {IMAGE}"), "method")
        store.save(CellRecord("folder", scene, method, "1", "0" * 64, failure=failure))
        return
    frames = moving_frames(m, k)
    indices = tuple(range(0, 2 * FRAMES, 2))
    scores = {
        "input_psnr": ScoreRecord.of(Score(30.0 - 5 * m + k, 1), SPECS[0]),
        "niqe": ScoreRecord.of(Score(3.0 + m + 0.1 * k, FRAMES), SPECS[1]),
        "musiq": ScoreRecord.without_value(SPECS[2], Unavailable(f"no {SCRIPT} weights", "weights", "get them")),
    }
    model: dict[str, object] = {"anchors": 900, "bytes": 4_000_000} if method == "orca" else {}
    if method == "orca":
        stages = {"original": 600, "outpainted": 200, "repaired": 100}
        model |= {"anchors_by_stage": stages, "repairs": 2, "repair_stopped": "nothing is left"}
    timing = {"phases": {"fit": 4.0}, "render_ms_per_frame": 20.0} if method == "orca" else {"phases": {"warp": 0.5}}
    notes = (f"made from {IMAGE}",)
    record = CellRecord("folder", scene, method, "1", "0" * 64, scores, frame_hashes(frames, indices), timing=timing)
    record = CellRecord(**{**record.__dict__, "model": model, "notes": notes})
    store.save(record)
    save_frames(store.frames_path(method, scene), MethodOutput(frames=frames))
    if method == "orca" and scene == "plain":
        folder = store.fresh_work_dir(method, scene)
        ledger = Ledger(RepairRules(), RepairRules(), (WIDTH, HEIGHT), (_repair(0), _repair(1)), "nothing is left", 2)
        (folder / "ledger.json").write_text(json.dumps(ledger.to_json()))
        small_scene(Camera.from_fov(WIDTH, HEIGHT, 60)).save(folder / "scene.safetensors")


def _repair(i: int) -> RepairRecord:
    side = (30, 20)[i]
    box, full = (5, 5, 5 + side, 5 + side), run_lengths(np.ones((side, side), bool))
    decision = ("local", "generative")[i]
    record = RepairRecord(i, 3 * i, side * side, 1.0, box, decision, "", "large", 9, "made up", 40, 0.1, 0.95, 1.0)
    return replace(record, rule=("generative_min_area", "all_hold")[i], mask=full)


def _run(images: Path) -> dict[str, object]:
    identity = {"dataset": "folder", "images": str(images), "trajectory": None, "preset": "draft", "seed": 0}
    return {
        "schema_version": 2,
        "identity": identity | {"device": "cpu", "codec": None},
        "scenes": list(SCENES),
        "methods": list(METHODS),
        "metrics": [spec.id for spec in SPECS],
        "method_versions": dict.fromkeys(METHODS, "version 1"),
        "metric_specs": {spec.id: spec.__dict__ for spec in SPECS},
        "folders": {"data_root": None},
        "commands": [f"python -m bench run --images {SCRIPT}"],
        "timing": {"started": "2026-01-02T03:04:05+00:00"},
        "host": {"cpu": "a processor", "cores": 2, "threads": 2, "versions": {"numpy": "2"}},
    }
