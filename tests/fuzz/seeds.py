"""Small sound files to start from, made by the writers themselves; nothing of them is kept in the repository."""

from __future__ import annotations

import io
import json
import pickle
import struct
import tarfile
import tempfile
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from bench.digest import unsealed
from tests.fuzz.targets import json_bytes, sound_run
from tests.fuzz.targets_metrics import HEADS, TRUNK

__all__ = ["dictionary", "seeds"]

_DICTIONARIES = {
    "trajectory": ("world_to_camera", "K", "width", "height", "K_512", "image_size", "video", "fps", "unit", "NaN"),
    "nerfstudio": ("frames", "transform_matrix", "fl_x", "w", "h", "cx", "camera_angle_x", "file_path", "k1", "1e999"),
    "colmap": ("PINHOLE", "SIMPLE_PINHOLE", "#", "nan", "1e308", "-1"),
    "record": ("schema_version", "scores", "frames", "failure", "identity", "notes", "digest", "timing"),
    "spec": ("frames:", "ply:", "file:", "onnx:", "?stage=", "unit=", "=", "&", "size=", "meaning=", "1e400", "nan"),
    "ply": ("element vertex ", "property float ", "end_header\n", "property list", "f_rest_0", "99999999999"),
    "tables": ("rows", "case", "method", "outcome", "scores", "key", "answer", "asked_of", "frame_sha256", "text"),
    "run": ("schema_version", "identity", "digest", "timing", "host", "scores", "frames", "disturbance", "answer"),
    "pickle": ("cnumpy\ndtype\n", "ctorch._utils\n_rebuild_tensor_v2\n", "cos\nsystem\n", "R", "b", "\x93"),
    "weights": (
        "ctorch._utils\n_rebuild_tensor_v2\n",
        "ctorch\nFloatStorage\n",
        "ccollections\nOrderedDict\n",
        "R",
        "Q",
    ),
    "chat": ("HTTP/1.1 200 OK\r\n", "Transfer-Encoding: chunked\r\n", "Content-Length: ", "Retry-After: ", "choices"),
    "options": (
        "orca@",
        "orca-paper@",
        "anchors=",
        "repair=off",
        "+",
        "canvas=",
        "price=",
        "psnr=",
        "preset=",
        "1e309",
    ),
    "scene": ("orca_scene", "__metadata__", "dtype", "shape", "data_offsets", "F32", "F64", "BOOL"),
}


def dictionary(target: str) -> str:
    """The words of a target in libFuzzer's format; may be empty."""
    words = _DICTIONARIES.get(target, ())
    return "".join('"' + "".join(f"\\x{byte:02x}" for byte in word.encode()) + '"\n' for word in words)


def seeds(target: str) -> Iterator[bytes]:
    """Sound inputs of a target."""
    with tempfile.TemporaryDirectory() as name:
        yield from _MAKERS[target](Path(name))


def _images(folder: Path) -> Iterator[bytes]:
    rng = np.random.default_rng(0)
    colour = Image.fromarray(rng.integers(0, 256, (16, 17, 3), dtype=np.uint8))
    for kind, image in (
        *((kind, colour) for kind in ("PNG", "JPEG", "BMP", "TIFF", "WEBP", "GIF")),
        *(("PNG", colour.convert(mode)) for mode in ("L", "1", "P", "RGBA")),
        ("TIFF", colour.convert("I")),
        ("TIFF", colour.convert("CMYK")),
        ("PNG", Image.fromarray(rng.integers(0, 65536, (16, 16), dtype=np.uint16))),
    ):
        buffer = io.BytesIO()
        image.save(buffer, kind)
        yield buffer.getvalue()


def _videos(folder: Path) -> Iterator[bytes]:
    from orca.video import write_video

    frames = np.random.default_rng(0).integers(0, 256, (2, 16, 16, 3), dtype=np.uint8)
    write_video(folder / "a.mp4", frames)
    yield (folder / "a.mp4").read_bytes()


def _scenes(folder: Path) -> Iterator[bytes]:
    import torch

    from tests.bench.test_adapter_orca_scene import wall_scene

    scene = wall_scene(2.0)
    replace(scene, anchors=scene.anchors.subset(torch.arange(2))).save(folder / "s.safetensors")
    content = (folder / "s.safetensors").read_bytes()
    (size,) = struct.unpack("<Q", content[:8])
    yield b"\0" + content[8 : 8 + size]
    yield b"\1" + content[: 8 + size]


def _plys(folder: Path) -> Iterator[bytes]:
    from tests.bench.splat_files import cloud_of, write_ply

    for degree in (0, 1):
        write_ply(folder / "a.ply", cloud_of(2, degree))
        yield (folder / "a.ply").read_bytes()


def _pickles(folder: Path) -> Iterator[bytes]:
    from tests.bench.splat_files import cloud_of, save_vistadream_scene

    save_vistadream_scene(folder / "scene.pth", cloud_of(4))
    content = (folder / "scene.pth").read_bytes()
    if len(content) < 8000:
        yield b"\x01" + content
    with zipfile.ZipFile(folder / "scene.pth") as archive:
        inner = next(name for name in archive.namelist() if name.endswith("data.pkl"))
        yield b"\0" + archive.read(inner)
    yield b"\0" + pickle.dumps({"a": [1, 2.5, "x"], "b": (True, None)}, protocol=2)
    yield b"\0" + pickle.dumps(np.arange(3.0), protocol=2)


def _trajectories(folder: Path) -> Iterator[bytes]:
    from bench.trajectories import build_trajectory
    from orca.camera import Camera

    document = build_trajectory("swing", Camera.from_fov(8, 8, 60.0), 2).to_json()
    yield json_bytes(document)
    poses = [np.eye(4).ravel().tolist()]
    K = [[8, 0, 4], [0, 8, 4], [0, 0, 1]]
    yield json_bytes({"K_512": K, "image_size": [8, 8], "video": {"fps": 20}, "world_to_camera": poses})


def _records(folder: Path) -> Iterator[bytes]:
    from tests.bench.test_store import a_record

    yield json_bytes(a_record().to_json())
    yield json_bytes({"schema_version": 2, "identity": {"dataset": "d"}, "timing": {"started": ""}})
    yield json_bytes({"schema_version": 1, "identity": {"dataset": "d"}, "started": ""})


def _nerfstudios(folder: Path) -> Iterator[bytes]:
    frame = {"file_path": "images/1.png", "transform_matrix": np.eye(4).tolist()}
    yield json_bytes({"w": 8, "h": 8, "fl_x": 8.0, "cx": 4, "cy": 4, "frames": [frame]})
    yield json_bytes({"w": 8, "h": 8, "camera_angle_x": 1.0, "camera_model": "OPENCV", "k1": 0, "frames": [frame]})


def _colmaps(folder: Path) -> Iterator[bytes]:
    images = b"1 1 0 0 0 0 0 0 1 a.png\n\n2 1 0 0 0 0.1 0 0 1 b.png\n\n"
    yield b"# cameras\n1 PINHOLE 8 8 8 8 4 4\n\0# images\n" + images
    yield b"1 SIMPLE_PINHOLE 8 8 8 4 4\n\0" + images


def _depths(folder: Path) -> Iterator[bytes]:
    import cv2

    values = np.linspace(1, 3, 256).reshape(16, 16)
    for dtype in (np.uint8, np.uint16):
        yield b"\0" + cv2.imencode(".png", (values * 80).astype(dtype))[1].tobytes()
    for array in (values, values.astype(np.float16), (values * 9).astype(">i4"), np.asfortranarray(values)):
        buffer = io.BytesIO()
        np.save(buffer, array)
        yield b"\1" + buffer.getvalue()


def _archives(folder: Path) -> Iterator[bytes]:
    for method in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        buffer = io.BytesIO()
        with zipfile.ZipFile(buffer, "w", method) as archive:
            archive.writestr("a/b.txt", b"hello" * 20)
            archive.writestr("c.txt", b"x")
        yield buffer.getvalue()
    for mode in ("w", "w:gz"):
        buffer = io.BytesIO()
        with tarfile.open(fileobj=buffer, mode=mode) as tar:
            for name in ("a/b.txt", "c.txt"):
                info = tarfile.TarInfo(name)
                info.size = 5
                tar.addfile(info, io.BytesIO(b"hello"))
        yield buffer.getvalue()


def _specs(folder: Path) -> Iterator[bytes]:
    for text in (
        "mine=frames:/a/b",
        "vistadream-scene:/runs?stage=coarse",
        "file:D.png?unit=0.0001&meaning=depth",
        "onnx:small.onnx?size=384x256&range=255&meaning=inverse_depth",
        "heuristic",
        "depth-anything?size=small",
    ):
        yield text.encode()


def _networks(folder: Path) -> Iterator[bytes]:
    from tests.orca.tiny_onnx import write_channel_mixer

    write_channel_mixer(folder / "n.onnx", (1.0, 2.0, 3.0))
    yield (folder / "n.onnx").read_bytes()


def _stored(folder: Path) -> Iterator[bytes]:
    from bench.frames import save_frames, stored_precision
    from tests.bench.test_store import an_output

    save_frames(folder / "f.npz", stored_precision(an_output(np.random.default_rng(0))))
    yield (folder / "f.npz").read_bytes()


def _run_files(folder: Path) -> Iterator[bytes]:
    """As they are, and without their seals, which hold off what is behind them."""
    for number, (_, content) in enumerate(sound_run()):
        yield bytes([number]) + content
        if b'"digest"' in content:
            yield bytes([number]) + json_bytes(unsealed(json.loads(content)))


def _other_json(folder: Path) -> Iterator[bytes]:
    yield json_bytes([{"case": "a", "method": "m", "outcome": "ok", "detail": "", "seconds": 1.5}])
    yield json_bytes({"bear": {"fx_512": 500.0, "forward_ratio": 0.2, "backward_ratio": 0.8}})
    yield json_bytes({"asked_of": "m", "frame_sha256": "0", "text": "q", "answer": "yes"}) + b"\n"
    yield json_bytes({"schema_version": 1, "key": "ab" * 32, "scores": {}})
    yield json.dumps("x").encode()


def _replies(folder: Path) -> Iterator[bytes]:
    answer = json_bytes({"choices": [{"message": {"role": "assistant", "content": "Yes"}}]})
    kind = b"Content-Type: application/json\r\n"
    yield b"HTTP/1.1 200 OK\r\n" + kind + b"Content-Length: %d\r\n\r\n" % len(answer) + answer
    yield b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n%x\r\n" % len(answer) + answer + b"\r\n0\r\n\r\n"
    yield b"HTTP/1.0 200 OK\r\n\r\n" + answer
    yield b"HTTP/1.1 429 Too Many Requests\r\nRetry-After: 3\r\n\r\nslow down"
    yield b'HTTP/1.1 404 Not Found\r\n\r\n{"error": "no such model"}'


def _priors(folder: Path) -> Iterator[bytes]:
    from scipy.io import savemat

    content = {"mu_prisparam": np.zeros((1, 36)), "cov_prisparam": np.eye(36)}
    for compressed in (True, False):
        savemat(folder / "p.mat", content, do_compression=compressed)
        yield (folder / "p.mat").read_bytes()
    savemat(folder / "p.mat", {"mu_prisparam": "text", "cov_prisparam": {"a": [1, 2]}})
    yield (folder / "p.mat").read_bytes()


def _weights(folder: Path) -> Iterator[bytes]:
    """In torch's format, as whole files and as pickles; and in its older format, which is no archive."""
    import torch

    for shapes, below in ((TRUNK, False), (HEADS, True)):
        state = {name: torch.zeros(shape) for name, shape in shapes.items()}
        torch.save({"params": state} if below else state, folder / "w.pth")
        yield b"\1" + (folder / "w.pth").read_bytes()
        with zipfile.ZipFile(folder / "w.pth") as archive:
            inner = next(name for name in archive.namelist() if name.endswith("data.pkl"))
            yield b"\0" + archive.read(inner)
    torch.save({"a": torch.ones(3)}, folder / "w.pth", _use_new_zipfile_serialization=False)
    yield b"\1" + (folder / "w.pth").read_bytes()


def _options(folder: Path) -> Iterator[bytes]:
    for text in (
        "orca@anchors=16384+repair=off",
        "orca-paper@preset=draft+decode=per_hit+price=0.5+views=3+canvas=1.5",
        "0.02,psnr=0.1",
        "slurm_partition=gpu",
        "2/8",
    ):
        yield text.encode()


_MAKERS = {
    "image": _images,
    "video": _videos,
    "scene": _scenes,
    "ply": _plys,
    "pickle": _pickles,
    "trajectory": _trajectories,
    "record": _records,
    "nerfstudio": _nerfstudios,
    "colmap": _colmaps,
    "depth": _depths,
    "archive": _archives,
    "spec": _specs,
    "onnx": _networks,
    "frames": _stored,
    "run": _run_files,
    "tables": _other_json,
    "chat": _replies,
    "niqe": _priors,
    "weights": _weights,
    "options": _options,
}
