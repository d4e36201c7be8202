"""Downloads against a real server on loopback: resumed, checked, refused, and safe to unpack."""

from __future__ import annotations

import contextlib
import hashlib
import io
import stat
import tarfile
import threading
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from bench.datasets import download as download_module
from bench.datasets.archives import unpack
from bench.datasets.download import Item, download, pixels_sha256
from bench.datasets.fetch import Fetcher, is_https, sha256_of
from bench.datasets.manifest import DIV2K, IMAGES, REALMDREAMER_SCENES, VIDEOS, Archive, Image, Video
from bench.datasets.realmdreamer import SCENES
from orca.errors import BadInput, OrcaError, Unavailable
from orca.images import load_image, save_image

CONTENT = bytes(range(256)) * 5000


@dataclass
class Site:
    """What the server does, and what it was asked."""

    url: str = ""
    files: dict[str, bytes] = field(default_factory=dict)
    break_after: list[int] = field(default_factory=list)  # bytes of each answer before the connection drops
    errors: list[int] = field(default_factory=list)  # statuses to give first
    ranges: bool = True
    redirect: str = ""
    asked: list[str | None] = field(default_factory=list)


@pytest.fixture
def site() -> Iterator[Site]:
    state = Site()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            state.asked.append(self.headers.get("Range"))
            if state.errors:
                self.send_error(state.errors.pop(0))
                return
            if state.redirect and self.path.endswith("/moved"):
                self.send_response(302)
                self.send_header("Location", state.redirect)
                self.end_headers()
                return
            content = state.files.get(self.path)
            if content is None:
                self.send_error(404)
                return
            start = 0
            wanted = self.headers.get("Range")
            if wanted and state.ranges:
                start = int(wanted.removeprefix("bytes=").rstrip("-"))
                if start >= len(content):
                    self.send_error(416)
                    return
                self.send_response(206)
                self.send_header("Content-Range", f"bytes {start}-{len(content) - 1}/{len(content)}")
            else:
                self.send_response(200)
            self.send_header("Content-Length", str(len(content) - start))
            self.end_headers()
            stop = start + state.break_after.pop(0) if state.break_after else len(content)
            self.wfile.write(content[start:stop])

        def log_message(self, format: str, *args: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    state.url = f"http://127.0.0.1:{server.server_port}"
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield state
    server.shutdown()
    server.server_close()


def on_loopback(url: str) -> bool:
    return urlsplit(url).hostname == "127.0.0.1"


LOCAL = Fetcher(allows=on_loopback, timeout=5, attempts=3, pause=0.0)


def digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def test_a_file_arrives_whole(site: Site, tmp_path: Path) -> None:
    site.files["/a"] = CONTENT
    seen: list[tuple[int, int]] = []
    target = tmp_path / "deep" / "a.bin"
    LOCAL.fetch(f"{site.url}/a", target, digest(CONTENT), len(CONTENT), lambda *at: seen.append(at))
    assert target.read_bytes() == CONTENT
    assert seen[-1] == (len(CONTENT), len(CONTENT))
    assert [p.name for p in target.parent.iterdir()] == ["a.bin"]


def test_a_broken_connection_is_gone_on_from(site: Site, tmp_path: Path) -> None:
    site.files["/a"] = CONTENT
    site.break_after = [1000, 70_000]
    LOCAL.fetch(f"{site.url}/a", tmp_path / "a", digest(CONTENT), len(CONTENT))
    assert (tmp_path / "a").read_bytes() == CONTENT
    assert site.asked == [None, "bytes=1000-", "bytes=71000-"]


def test_the_next_run_goes_on_where_the_last_gave_up(site: Site, tmp_path: Path) -> None:
    site.files["/a"] = CONTENT
    site.break_after = [10, 10, 10]
    with pytest.raises(Unavailable, match="goes on from where it stopped"):
        LOCAL.fetch(f"{site.url}/a", tmp_path / "a", digest(CONTENT), len(CONTENT))
    assert not (tmp_path / "a").exists()
    assert (tmp_path / ".a.part").stat().st_size == 30
    LOCAL.fetch(f"{site.url}/a", tmp_path / "a", digest(CONTENT), len(CONTENT))
    assert site.asked[-1] == "bytes=30-"
    assert (tmp_path / "a").read_bytes() == CONTENT


@pytest.mark.parametrize("left", [b"x" * 40, b"y" * (len(CONTENT) + 7)])
def test_a_part_of_something_else(site: Site, tmp_path: Path, left: bytes) -> None:
    """A shorter one gives a wrong hash and is thrown away; one that is too long is answered 416 and begun anew."""
    site.files["/a"] = CONTENT
    (tmp_path / ".a.part").write_bytes(left)
    fetch = lambda: LOCAL.fetch(f"{site.url}/a", tmp_path / "a", digest(CONTENT), len(CONTENT))  # noqa: E731
    if len(left) < len(CONTENT):
        with pytest.raises(BadInput, match="tampered"):
            fetch()
        assert not list(tmp_path.iterdir())
    fetch()
    assert (tmp_path / "a").read_bytes() == CONTENT


def test_a_server_without_ranges(site: Site, tmp_path: Path) -> None:
    site.files["/a"], site.ranges, site.break_after = CONTENT, False, [500]
    LOCAL.fetch(f"{site.url}/a", tmp_path / "a", digest(CONTENT), len(CONTENT))
    assert (tmp_path / "a").read_bytes() == CONTENT


def test_another_content_is_not_kept(site: Site, tmp_path: Path) -> None:
    site.files["/a"] = CONTENT[:-1] + b"!"
    with pytest.raises(BadInput, match="tampered"):
        LOCAL.fetch(f"{site.url}/a", tmp_path / "a", digest(CONTENT), len(CONTENT))
    assert not list(tmp_path.iterdir())


def test_a_larger_file_than_said_is_stopped(site: Site, tmp_path: Path) -> None:
    site.files["/a"] = CONTENT
    with pytest.raises(BadInput, match="bytes or more"):
        LOCAL.fetch(f"{site.url}/a", tmp_path / "a", digest(CONTENT), 1000)
    assert not list(tmp_path.iterdir())


def test_server_errors(site: Site, tmp_path: Path) -> None:
    site.files["/a"] = CONTENT
    site.errors = [500, 503]
    LOCAL.fetch(f"{site.url}/a", tmp_path / "a", digest(CONTENT), len(CONTENT))
    with pytest.raises(Unavailable, match=r"(?s)says 404.*SHA-256 abc"):
        LOCAL.fetch(f"{site.url}/none", tmp_path / "b", "abc", 10)
    assert len(site.asked) == 4  # a missing file is asked for once


def test_no_server_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(Unavailable, match=r"(?s)cannot fetch .*fetch it on another machine"):
        LOCAL.fetch("http://127.0.0.1:9/a", tmp_path / "a", "abc", 10)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "url", ["http://example.org/a", "ftp://example.org/a", "file:///etc/passwd", "https:///a", "a"]
)
def test_only_https(tmp_path: Path, url: str) -> None:
    assert not is_https(url)
    with pytest.raises(BadInput, match="allowed: https"):
        Fetcher().fetch(url, tmp_path / "a", "abc", 10)
    assert is_https("https://example.org/a")


@pytest.mark.parametrize("to", ["http://example.org/a", "file:///etc/passwd", "ftp://127.0.0.2/x"])
def test_a_redirect_elsewhere_is_refused(site: Site, tmp_path: Path, to: str) -> None:
    site.redirect = to
    with pytest.raises(OrcaError, match=r"leads to|says 302"):  # urllib itself refuses file:
        LOCAL.fetch(f"{site.url}/moved", tmp_path / "a", "abc", 10)
    site.redirect = f"{site.url}/a"
    site.files["/a"] = b"ok"
    LOCAL.fetch(f"{site.url}/moved", tmp_path / "a", digest(b"ok"), 10)


def test_two_downloads_of_one_file(site: Site, tmp_path: Path) -> None:
    import fcntl

    site.files["/a"] = CONTENT
    with (tmp_path / ".a.part").open("ab") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        with pytest.raises(BadInput, match="in use"):
            LOCAL.fetch(f"{site.url}/a", tmp_path / "a", digest(CONTENT), len(CONTENT))


def zipped(path: Path, members: dict[str, bytes], change: Callable[[zipfile.ZipInfo], None] | None = None) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            info = zipfile.ZipInfo(name)
            if change is not None:
                change(info)
            archive.writestr(info, content)
    return path


def tarred(path: Path, *members: tarfile.TarInfo, mode: str = "w:gz") -> Path:
    with tarfile.open(path, mode) as archive:  # type: ignore[call-overload]
        for info in members:
            archive.addfile(info, io.BytesIO(b"x" * info.size))
    return path


def plain(name: str, size: int = 3, kind: bytes = tarfile.REGTYPE, link: str = "") -> tarfile.TarInfo:
    info = tarfile.TarInfo(name)
    info.size, info.type, info.linkname = size, kind, link
    return info


def test_unpacking(tmp_path: Path) -> None:
    archive = zipped(tmp_path / "a.zip", {"x/": b"", "x/1.png": b"one", "x/y/2.png": b"two", "readme": b"no"})
    out = tmp_path / "out"
    written = unpack(archive, out, 1000, lambda name: name.endswith(".png"))
    assert [p.relative_to(out).as_posix() for p in written] == ["x/1.png", "x/y/2.png"]
    assert written[1].read_bytes() == b"two"
    assert not (out / "readme").exists()
    both = tarred(tmp_path / "a.tar.gz", plain("d", 0, tarfile.DIRTYPE), plain("d/e"))
    assert [p.read_bytes() for p in unpack(both, out, 1000)] == [b"xxx"]


ESCAPES = ["../evil", "x/../../evil", "/evil", "//evil", "..\\evil", "C:evil", "C:/evil", "x/..", "..", "."]


@pytest.mark.parametrize("name", ESCAPES)
@pytest.mark.parametrize("kind", ["zip", "tar"])
def test_a_way_out_is_refused_before_anything_is_written(tmp_path: Path, name: str, kind: str) -> None:
    inside = tmp_path / "in"
    if kind == "zip":
        archive = zipped(tmp_path / "a.zip", {"good": b"1", name: b"2"})
    else:
        archive = tarred(tmp_path / "a.tar", plain("good"), plain(name))
    with pytest.raises(BadInput, match="the name"):
        unpack(archive, inside, 1000)
    assert not inside.exists()
    assert not (tmp_path / "evil").exists()


def test_links_and_devices_are_refused(tmp_path: Path) -> None:
    def as_link(info: zipfile.ZipInfo) -> None:
        info.external_attr = (stat.S_IFLNK | 0o777) << 16

    archives = [zipped(tmp_path / "a.zip", {"link": b"/etc/passwd"}, as_link)]
    for index, (kind, link) in enumerate(
        [(tarfile.SYMTYPE, "/etc/passwd"), (tarfile.LNKTYPE, "../x"), (tarfile.CHRTYPE, ""), (tarfile.FIFOTYPE, "")]
    ):
        archives.append(tarred(tmp_path / f"{index}.tar", plain("good"), plain("bad", 0, kind, link), mode="w"))
    for archive in archives:
        with pytest.raises(BadInput, match="link"):
            unpack(archive, tmp_path / "in", 1000)
    assert not (tmp_path / "in").exists()


def test_a_link_that_was_there_before_is_not_followed(tmp_path: Path) -> None:
    inside, outside = tmp_path / "in", tmp_path / "out"
    inside.mkdir()
    outside.mkdir()
    (inside / "x").symlink_to(outside)
    with pytest.raises(BadInput, match="leads elsewhere"):
        unpack(zipped(tmp_path / "a.zip", {"x/1": b"1"}), inside, 1000)
    assert not list(outside.iterdir())


def test_bombs_doubles_and_damage(tmp_path: Path) -> None:
    inside = tmp_path / "in"
    with pytest.raises(BadInput, match="more than"):
        unpack(zipped(tmp_path / "a.zip", {"a": b"\0" * 10**6}), inside, 10**5)
    with pytest.raises(BadInput, match="two members"):
        unpack(zipped(tmp_path / "b.zip", {"a": b"1", "A": b"2"}), inside, 1000)
    whole = zipped(tmp_path / "c.zip", {"a": b"12345" * 100}).read_bytes()
    (tmp_path / "c.zip").write_bytes(whole.replace(whole[31:36], b"\xff\xff\xff\xff\xff", 1))
    with pytest.raises(BadInput, match="damaged"):
        unpack(tmp_path / "c.zip", inside, 1000)
    (tmp_path / "d.zip").write_bytes(b"neither")
    with pytest.raises(BadInput, match="no archive"):
        unpack(tmp_path / "d.zip", inside, 1000)
    assert not any(p.is_file() for p in inside.rglob("*"))


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(changes=st.lists(st.tuples(st.integers(0, 10**4), st.integers(0, 255)), max_size=5), tar=st.booleans())
@example(changes=[(302, 0)], tar=False)  # an empty name, at which zipfile trips
def test_a_damaged_archive_never_writes_outside(tmp_path: Path, changes: list[tuple[int, int]], tar: bool) -> None:
    source = tmp_path / "source"
    if tar:
        tarred(source, plain("a/b"), plain("c"), mode="w")
    else:
        zipped(source, {"a/b": b"1234", "c": b"5"})
    content = bytearray(source.read_bytes())
    for place, value in changes:
        content[place % len(content)] = value
    archive = tmp_path / "around" / "archive"
    archive.parent.mkdir(exist_ok=True)
    archive.write_bytes(bytes(content))
    with contextlib.suppress(OrcaError):
        unpack(archive, tmp_path / "around" / "in", 10**5)
    assert {p.name for p in (tmp_path / "around").iterdir()} <= {"archive", "in"}
    assert {p.name for p in tmp_path.iterdir()} <= {"source", "around"}


@pytest.fixture
def small_site(site: Site, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Site:
    """One of each kind of file, on loopback."""
    site.files["/rgb.mp4"] = CONTENT
    rng = np.random.default_rng(0)
    large = rng.integers(0, 255, (640, 640, 4), np.uint8)
    from PIL import Image as Pillow

    buffer = io.BytesIO()
    Pillow.fromarray(large, "RGBA").save(buffer, "PNG")
    site.files["/bear.png"] = buffer.getvalue()
    import cv2

    converted = np.asarray(cv2.resize(large[:, :, :3], (512, 512), interpolation=cv2.INTER_AREA))
    zipped(tmp_path / "d.zip", {"X/0801x2.png": b"p1", "X/0802x2.png": b"p2"})
    site.files["/d.zip"] = (tmp_path / "d.zip").read_bytes()
    zip_bytes = site.files["/d.zip"]
    videos = (
        Video("vistadream/rgb/bear.mp4", f"{site.url}/rgb.mp4", len(CONTENT), digest(CONTENT)),
        Video("vistadream/rgb/gone.mp4", f"{site.url}/gone.mp4", 10, "abc"),
    )
    images = (Image("realmdreamer/images/bear.png", f"{site.url}/bear.png", pixels_sha256(converted)),)
    names = ("X/0801x2.png", "X/0802x2.png")
    archive = Archive("div2k", f"{site.url}/d.zip", len(zip_bytes), digest(zip_bytes), names)
    for name, value in (("VIDEOS", videos), ("IMAGES", images), ("DIV2K", archive)):
        monkeypatch.setattr(download_module, name, value)
    return site


def states(items: list[Item], root: Path) -> dict[str, str]:
    return {item.path.relative_to(root).as_posix(): item.state for item in items}


def test_downloading_videos(small_site: Site, tmp_path: Path) -> None:
    root = tmp_path / "root"
    planned = states(download("vistadream", root, LOCAL, dry_run=True), root)
    assert planned["vistadream/rgb/bear.mp4"] == "missing"
    assert planned["vistadream/dpt/car.mp4"] == "by hand"
    assert not root.exists()
    assert not small_site.asked
    got = download("vistadream", root, LOCAL)
    assert states(got, root)["vistadream/rgb/bear.mp4"] == "fetched"
    assert states(got, root)["vistadream/rgb/gone.mp4"] == "failed"
    assert "says 404" in next(item.detail for item in got if item.state == "failed")
    assert states(download("vistadream", root, LOCAL), root)["vistadream/rgb/bear.mp4"] == "here"
    (root / "vistadream/rgb/bear.mp4").write_bytes(b"mine")
    again = download("vistadream", root, LOCAL)
    assert states(again, root)["vistadream/rgb/bear.mp4"] == "failed"
    assert (root / "vistadream/rgb/bear.mp4").read_bytes() == b"mine"


def test_downloading_images(small_site: Site, tmp_path: Path) -> None:
    root = tmp_path / "root"
    got = states(download("realmdreamer", root, LOCAL), root)
    assert got["realmdreamer/images/bear.png"] == "fetched"
    assert got["realmdreamer/scenes.json"] == "fetched"
    assert got["realmdreamer/depth/bear.png"] == "by hand"
    assert load_image(root / "realmdreamer/images/bear.png").shape == (512, 512, 3)
    assert [p.name for p in (root / "realmdreamer/images").iterdir()] == ["bear.png"]
    assert states(download("realmdreamer", root, LOCAL), root)["realmdreamer/images/bear.png"] == "here"
    save_image(root / "realmdreamer/images/bear.png", np.zeros((512, 512, 3), np.uint8))
    assert states(download("realmdreamer", root, LOCAL), root)["realmdreamer/images/bear.png"] == "failed"
    small_site.files["/bear.png"] = b"no image"
    (root / "realmdreamer/images/bear.png").unlink()
    failed = next(item for item in download("realmdreamer", root, LOCAL) if item.state == "failed")
    assert "not an image" in failed.detail
    assert not list((root / "realmdreamer/images").iterdir())


def test_downloading_an_archive(small_site: Site, tmp_path: Path) -> None:
    root = tmp_path / "root"
    got = states(download("div2k", root, LOCAL), root)
    assert got == {"div2k/X/0801x2.png": "fetched", "div2k/X/0802x2.png": "fetched"}
    assert sorted(p.name for p in (root / "div2k").iterdir()) == ["X"]
    (root / "div2k/X/0802x2.png").unlink()
    (root / "div2k/X/0801x2.png").write_bytes(b"kept")
    assert states(download("div2k", root, LOCAL), root) == {"div2k/X/0802x2.png": "fetched"}
    assert (root / "div2k/X/0801x2.png").read_bytes() == b"kept"
    assert set(states(download("div2k", root, LOCAL), root).values()) == {"here"}


def test_offline_stops_at_the_first_file(small_site: Site, tmp_path: Path) -> None:
    nowhere = Fetcher(allows=on_loopback, attempts=1)
    videos = (Video("v/a", "http://127.0.0.1:9/a", 1, "x"), Video("v/b", "http://127.0.0.1:9/b", 1, "x"))
    download_module.VIDEOS = videos  # the fixture's monkeypatch puts it back
    with pytest.raises(Unavailable, match=r"(?s)127\.0\.0\.1:9/a.*put it there"):
        download("vistadream", tmp_path / "root", nowhere)
    with pytest.raises(BadInput, match="'photos'"):
        download("photos", tmp_path, nowhere)


def test_the_manifest() -> None:
    """Every address is https; every hash is one; every scene has its files; paths stay below the data root."""
    for item in (*VIDEOS, *IMAGES, DIV2K):
        assert is_https(item.url)
    hashes = [*(v.sha256 for v in VIDEOS), *(i.pixels_sha256 for i in IMAGES), DIV2K.sha256]
    assert all(len(h) == 64 and int(h, 16) for h in hashes)
    assert len(set(hashes)) == len(hashes) == 34
    assert {Path(v.path).stem for v in VIDEOS} == {Path(i.path).stem for i in IMAGES} == set(SCENES)
    assert set(REALMDREAMER_SCENES) == set(SCENES)
    assert len(DIV2K.members) == 100


def test_the_manifest_against_the_files(data_root: Path) -> None:
    import json

    for video in VIDEOS[:4]:
        assert sha256_of(data_root / video.path) == video.sha256
        assert (data_root / video.path).stat().st_size == video.size
    for image in IMAGES:
        assert pixels_sha256(load_image(data_root / image.path)) == image.pixels_sha256
    stored = json.loads((data_root / "realmdreamer" / "scenes.json").read_text())
    for scene, facts in REALMDREAMER_SCENES.items():
        assert {key: stored[scene][key] for key in facts} == facts
