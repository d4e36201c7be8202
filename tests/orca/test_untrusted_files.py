"""Files that lie about themselves: refused by a typed error before memory is taken, and nothing of them is run."""

from __future__ import annotations

import io
import json
import pickle
import struct
import subprocess
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from safetensors.torch import save_file

from bench.adapters.video_facts import video_facts
from orca.array_file import decode_png, read_npy, read_png
from orca.camera_file import read_camera_document
from orca.errors import BadInput
from orca.export import read_ply
from orca.images import load_image
from orca.json_file import MAX_BYTES, parse_json, read_json_file
from orca.priors.onnx import MAX_BYTES as MAX_NETWORK_BYTES
from orca.priors.onnx import OnnxDepth
from orca.scene import Scene
from orca.video import read_video, write_video
from tests.bench.test_adapter_orca_scene import wall_scene
from tests.orca.test_scene import _rewrite, _with


def sparse(path: Path, size: int, start: bytes = b"") -> Path:
    """A file that says it is large and takes no room."""
    path.write_bytes(start)
    with path.open("r+b") as file:
        file.truncate(size)
    return path


def png(width: int, height: int, bits: int = 16) -> bytes:
    """A PNG whose header claims a size that its few bytes do not hold."""

    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    head = struct.pack(">IIBBBBB", width, height, bits, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(bytes(64))) + chunk(b"IEND", b"")


def test_no_other_program_is_started_for_an_image(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pillow hands EPS to Ghostscript."""

    def started(*_: object, **__: object) -> None:
        raise AssertionError("a program was started")

    monkeypatch.setattr(subprocess, "Popen", started)
    eps = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 64 64\n%%EndComments\n(%pipe%touch x) (r) file\n%%EOF\n"
    (tmp_path / "a.png").write_bytes(eps)
    with pytest.raises(BadInput, match="is not an image"):
        load_image(tmp_path / "a.png")


@pytest.mark.parametrize("kind", ["GIF", "WEBP", "PNG"])
def test_the_first_frame_of_an_animation(tmp_path: Path, kind: str) -> None:
    frames = [Image.new("RGB", (20, 18), colour) for colour in ("red", "blue", "lime")]
    frames[0].save(tmp_path / "a", kind, save_all=True, append_images=frames[1:], lossless=True)
    assert load_image(tmp_path / "a")[5, 5].tolist() == [255, 0, 0]


def test_an_image_that_ends_early_anywhere(tmp_path: Path) -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (24, 24, 3), dtype=np.uint8)
    for kind in ("PNG", "JPEG", "TIFF", "BMP", "WEBP", "GIF"):
        buffer = io.BytesIO()
        Image.fromarray(pixels).save(buffer, kind)
        whole = buffer.getvalue()
        for share in (0.02, 0.1, 0.5, 0.8):
            (tmp_path / "a").write_bytes(whole[: int(len(whole) * share)])
            with pytest.raises(BadInput):
                load_image(tmp_path / "a")


def test_arrays_claim_no_more_than_they_hold(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    for width, height in ((60_000, 60_000), (0, 5), (2**31 - 1, 2**31 - 1), (16, 16)):
        path.write_bytes(png(width, height)[: 10_000 if width != 16 else 50])
        with pytest.raises(BadInput):
            read_png(path)
    path.write_bytes(b"II*\0" + bytes(200))  # OpenCV would read other formats, with other limits
    with pytest.raises(BadInput, match="not a PNG"):
        read_png(path)
    for shape in ((10**6, 10**6), (2**62,), (2, 2)):
        np.lib.format.write_array_header_1_0(
            head := io.BytesIO(), {"descr": "<f8", "fortran_order": False, "shape": shape}
        )
        (tmp_path / "a.npy").write_bytes(head.getvalue())
        with pytest.raises(BadInput, match=r"NPY|values"):
            read_npy(tmp_path / "a.npy")
    sparse(tmp_path / "a.npy", 8 * 10**9 + len(head.getvalue()), _npy_header((10**9,)))
    with pytest.raises(BadInput, match="at most"):
        read_npy(tmp_path / "a.npy")


def _npy_header(shape: tuple[int, ...]) -> bytes:
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return head.getvalue()


def _png_with(kind: bytes, body: bytes = b"", claimed: int | None = None) -> bytes:
    """A sound PNG of 16x16 with one more part after its header."""
    buffer = io.BytesIO()
    Image.new("L", (16, 16)).save(buffer, "PNG")
    sound = buffer.getvalue()
    size = len(body) if claimed is None else claimed
    part = struct.pack(">I", size) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
    return sound[:33] + part + sound[33:]


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (_png_with(b"IDAT", claimed=2**32 - 1), "claims 4294967295 bytes"),
        (_png_with(b"tEXt", b"a", claimed=2**20), "claims 1048576 bytes"),
        (_png_with(b"IHDR", bytes(13)), "no single header"),
        (_png_with(b"acTL", bytes(8)), "an animation"),
        (_png_with(b"tEXt", b"a\0b")[:-12], "ends before it is whole"),
        (_png_with(b"tEXt", b"a\0b")[:-1], "ends before it is whole"),
    ],
)
def test_a_png_is_whole_before_it_is_decoded(content: bytes, why: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """OpenCV 5 takes the memory that a part claims before it looks for the part."""
    assert decode_png(_png_with(b"tEXt", b"a\0b"), "it").shape == (16, 16)
    monkeypatch.setattr("cv2.imdecode", None)
    with pytest.raises(BadInput, match=why):
        decode_png(content, "it")


class _Touches:
    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Callable[[Path], None], tuple[Path]]:
        return Path.touch, (self.path,)


def test_an_array_of_objects_is_not_unpickled(tmp_path: Path) -> None:
    trap = np.empty(1, object)
    trap[0] = _Touches(tmp_path / "touched")
    np.save(tmp_path / "a.npy", trap, allow_pickle=True)
    with pytest.raises(BadInput):
        read_npy(tmp_path / "a.npy")
    (tmp_path / "b.npy").write_bytes(pickle.dumps(_Touches(tmp_path / "touched")))
    with pytest.raises(BadInput):
        read_npy(tmp_path / "b.npy")
    assert not (tmp_path / "touched").exists()


def _h264(side: int, count: int) -> bytes:
    import av

    buffer = io.BytesIO()
    with av.open(buffer, "w", format="h264") as container:
        stream = container.add_stream("libx264", rate=20)
        stream.width = stream.height = side
        stream.pix_fmt = "yuv420p"
        for _ in range(count):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.zeros((side, side, 3), np.uint8), "rgb24")))
        container.mux(stream.encode(None))
    return buffer.getvalue()


def test_a_video_that_changes_size(tmp_path: Path) -> None:
    (tmp_path / "a.h264").write_bytes(_h264(32, 3) + _h264(64, 3))
    with pytest.raises(BadInput, match="frame 3 is 64x64"):
        read_video(tmp_path / "a.h264")
    assert read_video(tmp_path / "a.h264", (0, 1)).shape == (2, 32, 32, 3)


def test_a_video_that_claims_to_be_huge_or_has_no_frames(tmp_path: Path) -> None:
    for size in ("W100000 H100000", "W0 H0"):
        (tmp_path / "a.y4m").write_bytes(f"YUV4MPEG2 {size} F20:1\nFRAME\n".encode() + bytes(600))
        with pytest.raises(BadInput):
            read_video(tmp_path / "a.y4m")
    (tmp_path / "none.y4m").write_bytes(b"YUV4MPEG2 W16 H16 F20:1\n")
    with pytest.raises(BadInput):
        read_video(tmp_path / "none.y4m")


@pytest.mark.parametrize(
    "playlist",
    [
        "#EXTM3U\n#EXT-X-VERSION:3\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\nother.mp4\n#EXT-X-ENDLIST\n",
        "ffconcat version 1.0\nfile other.mp4\n",
    ],
    ids=["HLS", "concat"],
)
def test_a_video_does_not_lead_to_other_files(tmp_path: Path, playlist: str) -> None:
    """A playlist under the name of a video: the decoder would open whatever it lists, addresses too."""
    import av

    write_video(tmp_path / "other.mp4", np.zeros((3, 32, 32, 3), np.uint8))
    (tmp_path / "a.mp4").write_text(playlist)
    if "concat" in playlist:  # HLS is refused by the decoder itself under this name
        with av.open(str(tmp_path / "a.mp4")) as container:
            assert container.format.name == "concat"
    with pytest.raises(BadInput, match="unreadable"):
        read_video(tmp_path / "a.mp4")
    with pytest.raises(BadInput, match="unreadable"):
        video_facts(tmp_path / "a.mp4")


def test_a_video_that_ends_early_anywhere(tmp_path: Path) -> None:
    frames = np.random.default_rng(0).integers(0, 256, (6, 32, 32, 3), dtype=np.uint8)
    write_video(tmp_path / "a.mp4", frames)
    whole = (tmp_path / "a.mp4").read_bytes()
    for share in (0.05, 0.2, 0.5, 0.9, 0.97):
        (tmp_path / "cut.mp4").write_bytes(whole[: int(len(whole) * share)])
        with pytest.raises(BadInput):
            read_video(tmp_path / "cut.mp4", (5,))


def _tensor(name: str, change: Callable[[Any], Any]) -> Callable[[dict[str, Any], dict[str, Any]], None]:
    return lambda document, tensors: tensors.__setitem__(name, change(tensors[name]))


SCENES = {
    "NaN": _tensor("anchors.means", lambda t: t * float("nan")),
    "infinite decoder": _tensor("decoders.colour_out.weight", lambda t: t / 0.0),
    "doubles": _tensor("anchors.features", lambda t: t.double()),
    "stage of nothing": _tensor("anchors.stage", lambda t: t + 200),
    "hits": _with("render_config.max_hits", 10**12),
    "no hits": _with("render_config.max_hits", 0),
    "hits in words": _with("render_config.max_hits", "many"),
    "window": _with("render_config.window", -5),
    "decode": _with("render_config.decode", "__import__"),
    "camera": _with("camera.width", 10**7),
    "endless camera": _with("camera.width", float("inf")),
    "camera of NaN": _with("camera.K", [[float("nan")] * 3] * 3),
    "provenance": _with("provenance", "me"),
}


@pytest.mark.parametrize("name", SCENES)
def test_a_scene_that_would_hurt_the_renderer(tmp_path: Path, name: str) -> None:
    path = tmp_path / "scene.safetensors"
    wall_scene(2.0).save(path)
    _rewrite(path, SCENES[name])
    with pytest.raises(BadInput):
        Scene.load(path)


def test_a_scene_file_that_claims_more_than_it_holds(tmp_path: Path) -> None:
    import torch

    path = tmp_path / "scene.safetensors"
    for size in (2**60, 10**8, 5):
        path.write_bytes(struct.pack("<Q", size) + b"{}" * 10)
        with pytest.raises(BadInput):
            Scene.load(path)
    header = json.dumps({"a": {"dtype": "F32", "shape": [2**31, 2**31], "data_offsets": [0, 8]}}).encode()
    path.write_bytes(struct.pack("<Q", len(header)) + header + bytes(8))
    with pytest.raises(BadInput):
        Scene.load(path)
    save_file({"x": torch.zeros(1)}, str(path), {"orca_scene": "[" * 100_000})
    with pytest.raises(BadInput):
        Scene.load(path)


def test_json_of_any_size_and_depth(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    for content in (b"[" * 200_000, b"\xff\xfe{}", b"{", b"", b"nul", b'{"a": 1e}'):
        path.write_bytes(content)
        with pytest.raises(BadInput):
            read_json_file(path, "an object")
        with pytest.raises(BadInput):
            read_camera_document(path)
    assert parse_json(b'\xef\xbb\xbf{"a": 1}', "it", "an object") == {"a": 1}
    with pytest.raises(BadInput, match="bytes"):
        read_json_file(sparse(path, MAX_BYTES + 1), "an object")
    with pytest.raises(BadInput, match="cannot be read"):
        read_json_file(tmp_path, "an object")


def test_a_ply_that_lies(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    head = "ply\nformat binary_little_endian 1.0\nelement vertex {}\n{}end_header\n"
    x = "property float x\n"
    for text in (
        head.format(10**17, x),
        head.format("9" * 5000, x),
        head.format("٣", x),
        head.format(1, x * 2),
        head.format(1, ""),
    ):
        path.write_bytes(text.encode() + bytes(8))
        with pytest.raises(BadInput):
            read_ply(path)
    with pytest.raises(BadInput, match="at most"):
        read_ply(sparse(path, 2**34, head.format(1, x).encode()))


def test_a_network_that_is_none(tmp_path: Path) -> None:
    path = tmp_path / "a.onnx"
    for content in (b"", b"\0" * 100, b"not a network", bytes(range(256)) * 4, b"\x3a\xff\xff\xff\xff\x0f" + bytes(8)):
        path.write_bytes(content)
        with pytest.raises(BadInput):
            OnnxDepth(path, 8, 8)._load()
    with pytest.raises(BadInput, match="at most"):
        OnnxDepth(sparse(path, MAX_NETWORK_BYTES + 1), 8, 8)._load()
