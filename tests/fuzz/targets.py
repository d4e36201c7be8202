"""What is fuzzed: each target hands its bytes to readers, which may refuse them with an `OrcaError` only."""

from __future__ import annotations

import json
import re
import shutil
import struct
import zipfile
from functools import cache
from pathlib import Path

import numpy as np

from orca.camera import Camera
from tests.fuzz import targets_metrics
from tests.fuzz.target import Target, each, folder, input_file, refused_or_read

__all__ = ["TARGETS", "Target", "folder", "refused_or_read"]


def _image(content: bytes) -> None:
    from orca.images import load_image

    load_image(input_file("image.png", content))


def _video(content: bytes) -> None:
    from bench.adapters.video_facts import video_facts
    from orca.video import read_video

    path = input_file("video.mp4", content)
    read_video(path)
    video_facts(path)


def _scene(content: bytes) -> None:
    """The first byte says whether the rest is the header of a file of zeros (even) or the whole file (odd)."""
    from orca.scene import Scene

    if content[:1] and content[0] % 2 == 0:
        header = content[1:]
        ends = [int(end) for end in re.findall(rb"\[\s*\d+\s*,\s*(\d{1,6})\s*\]", header)]
        content = b"\0" + struct.pack("<Q", len(header)) + header + bytes(max(ends, default=0))
    Scene.load(input_file("scene.safetensors", content[1:]))


def _ply(content: bytes) -> None:
    from bench.adapters.gaussian_ply import read_gaussian_ply
    from orca.export import read_splats

    path = input_file("splats.ply", content)
    read_gaussian_ply(path)
    read_splats(path)


def _pickle(content: bytes) -> None:
    """The first byte says whether the rest is the pickle inside a sound archive (even) or the whole file (odd)."""
    from bench.adapters.vistadream_scene import read_vistadream_scene

    if content[:1] and content[0] % 2 == 0:
        path = folder() / "scene.pth"
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("archive/data.pkl", content[1:])
            for key in range(12):
                archive.writestr(f"archive/data/{key}", bytes(256))
    else:
        path = input_file("scene.pth", content[1:])
    read_vistadream_scene(path)


def _trajectory(content: bytes) -> None:
    from bench.trajectories import load_trajectory
    from orca.camera_file import read_cameras

    path = input_file("cameras.json", content)
    load_trajectory(path)
    read_cameras(path)


def _record(content: bytes) -> None:
    from bench.record import CellRecord
    from bench.store import RunStore, read_json

    path = input_file("run.json", content)
    each(lambda: RunStore(folder()).load_run(), lambda: CellRecord.from_json(read_json(path), str(path)))


def _nerfstudio(content: bytes) -> None:
    from bench.cameras_io import read_camera_file

    read_camera_file(input_file("transforms.json", content))


def _colmap(content: bytes) -> None:
    """cameras.txt, a zero byte, images.txt."""
    from bench.cameras_io import read_camera_file

    cameras, _, images = content.partition(b"\0")
    place = folder() / "colmap"
    place.mkdir(exist_ok=True)
    (place / "cameras.txt").write_bytes(cameras)
    (place / "images.txt").write_bytes(images)
    read_camera_file(place)


def _depth(content: bytes) -> None:
    """The first byte chooses PNG or NPY, as a depth file, or as one of a folder of images."""
    from bench.datasets.folder import _read_depth
    from orca.priors.depth import parse_depth_spec

    suffix = "npy" if content[:1] and content[0] % 2 else "png"
    path = input_file(f"image.depth.{suffix}", content[1:])
    image = np.zeros((16, 16, 3), np.float32)
    try:
        parse_depth_spec(f"file:{path}?fill=1&resize=1").estimate(image, Camera.from_fov(16, 16, 60.0))
    finally:
        _read_depth(path, image.astype(np.uint8))


def _archive(content: bytes) -> None:
    from bench.datasets.archives import unpack

    place = folder() / "unpacked"
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir()
    before = set(folder().iterdir())
    path = input_file("archive.bin", content)
    try:
        unpack(path, place, 1 << 20)
    finally:
        if set(folder().iterdir()) - before - {path} or any(p.is_symlink() for p in place.rglob("*")):
            raise AssertionError("something was written outside the folder, or is a link")


def _spec(content: bytes) -> None:
    from bench.adapters.external import is_external, parse_external
    from orca.priors.depth import parse_depth_spec

    text = content.decode("utf-8", "surrogateescape")
    try:
        if is_external(text):
            parse_external(text)
    finally:
        parse_depth_spec(text)


def _onnx(content: bytes) -> None:
    from orca.priors.onnx import OnnxDepth

    network = OnnxDepth(input_file("network.onnx", content), 8, 8)
    network.estimate(np.full((16, 16, 3), 0.5, np.float32), Camera.from_fov(16, 16, 60.0))


def _frames(content: bytes) -> None:
    """Stored frames: `load_frames` refuses by returning None."""
    from bench.frames import load_frames
    from bench.record import CellRecord, StoredFrame

    record = CellRecord("d", "s", "m", "1", None, frames=(StoredFrame(0, "0" * 64),))
    load_frames(input_file("frames.npz", content), record)


def _tables(content: bytes) -> None:
    """The other JSON that is read: scenes.json, rows of stability, kept scores, kept answers."""
    from bench.datasets.realmdreamer import RealmDreamer
    from bench.metrics.llava_answers import Answers
    from bench.report.stability import read_stability
    from bench.scorecache import ScoreCache

    Answers(input_file("llava.jsonl", content))
    place = folder() / "realmdreamer"
    place.mkdir(exist_ok=True)
    (place / "scenes.json").write_bytes(content)
    key = "ab" * 32
    kept = folder() / "scores" / key[:2]
    kept.mkdir(parents=True, exist_ok=True)
    (kept / f"{key}.json").write_bytes(content)
    ScoreCache(folder() / "scores").get(key, {})
    rows = input_file("stability.json", content)
    each(lambda: RealmDreamer(folder()).scenes(), lambda: read_stability(rows))


# What of a run's folder is fuzzed; llava.jsonl and curves.json are made up, since the fakes leave none.
_RUN_FILES = ("run.json", "scenes/dark/a.json", "cache/scores/*/*.json", "answers/llava.jsonl", "curves.json")
_ANSWER = b'{"asked_of": "m", "frame_sha256": "0", "text": "q", "answer": "yes"}\n'
_CURVE = b'{"rows": [{"disturbance": "noise", "level": 0.1, "method": "m", "version": "1", "outcome": "ok"}]}'


@cache
def sound_run() -> tuple[tuple[Path, bytes], ...]:
    """A small finished run: the files of `_RUN_FILES` and what they hold."""
    from bench.runner import RunRequest, run_bench
    from tests.bench import spine_fakes as fakes

    root = folder() / "run"
    request = RunRequest(fakes.FakeDataset(), ("a",), ("dark",), ("bright",), root)
    run_bench(request, methods=fakes.METHODS, metrics=fakes.METRICS)
    for name, content in (("answers/llava.jsonl", _ANSWER), ("curves.json", _CURVE)):
        (root / name).parent.mkdir(exist_ok=True)
        (root / name).write_bytes(content)
    shutil.copytree(root, folder() / "other")
    return tuple((path, path.read_bytes()) for name in _RUN_FILES for path in root.glob(name))


def _run(content: bytes) -> None:
    """The first byte says which of a run's files the rest is; then the run is checked, and merged with a sound one."""
    from bench.merge import merge_runs
    from bench.stability.curves import CurveRows
    from bench.verify import verify_run

    path, sound = sound_run()[content[0] % len(sound_run()) if content else 0]
    root, out = folder() / "run", folder() / "merged"
    shutil.rmtree(out, ignore_errors=True)
    path.write_bytes(content[1:])
    try:
        each(
            lambda: verify_run(root),
            lambda: CurveRows(root).rows(),
            lambda: merge_runs(out, (folder() / "other", root)),
        )
    finally:
        path.write_bytes(sound)


def json_bytes(document: object) -> bytes:
    """A document as the seeds write it."""
    return json.dumps(document).encode()


TARGETS: dict[str, Target] = {
    "image": Target(_image, "`orca.images.load_image`", 8192, native=True),
    "video": Target(_video, "`orca.video.read_video`, `video_facts`", 8192, native=True),
    "scene": Target(_scene, "`Scene.load` (safetensors)", 16384, native=True, json=True, marked=True),
    "ply": Target(_ply, "`read_gaussian_ply`, `read_splats`", 4096),
    "pickle": Target(_pickle, "`read_vistadream_scene`: restricted pickle, torch file", 8192),
    "trajectory": Target(_trajectory, "`load_trajectory`, `read_cameras`", 4096, json=True),
    "record": Target(_record, "`CellRecord.from_json`, `RunStore.load_run`", 4096, json=True),
    "nerfstudio": Target(_nerfstudio, "`read_camera_file` (transforms.json)", 4096, json=True),
    "colmap": Target(_colmap, "`read_camera_file` (cameras.txt, images.txt)", 2048),
    "depth": Target(_depth, "`FileDepth`, depth of `ImageFolder` (PNG, NPY)", 4096, native=True),
    "archive": Target(_archive, "`unpack` (zip, tar)", 16384),
    "spec": Target(_spec, "`parse_external`, `parse_depth_spec`", 512),
    "onnx": Target(_onnx, "`OnnxDepth`", 4096, native=True),
    "frames": Target(_frames, "`load_frames` (npz of PNG)", 8192, native=True),
    "run": Target(_run, "`merge_runs`, `verify_run`, `CurveRows`: a folder of a run", 16384, json=True, marked=True),
    "tables": Target(_tables, "scenes.json, stability rows, kept scores and answers", 2048, json=True),
    "chat": Target(targets_metrics.chat, "`ChatClient.ask`: a server's reply, headers included", 2048),
    "niqe": Target(targets_metrics.niqe, "`NiqePrior.read`, `read_matrices` (MATLAB 5 file)", 16384),
    "weights": Target(
        targets_metrics.weights,
        "`trunk_state`, `head_state`, `read_musiq_state` (torch file)",
        8192,
        instrument=("torch.serialization", "torch._weights_only_unpickler"),
    ),
    "options": Target(targets_metrics.options, "points, `parse_thresholds`, `parse_options`, `parse_shard`", 256),
}
