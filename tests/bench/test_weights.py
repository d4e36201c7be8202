"""Weights files: addresses, hashes, and fetching them from a real server on the loopback."""

from __future__ import annotations

import hashlib
import re
import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from bench.datasets.download import download
from bench.datasets.fetch import Fetcher
from bench.metrics import weights_fetch
from bench.metrics.weights import WeightsFile
from bench.metrics.weights_fetch import SINGLE_FILES
from orca.errors import BadInput, Unavailable

CONTENT = b"weights" * 1000
SHA256 = hashlib.sha256(CONTENT).hexdigest()


@pytest.fixture
def site(tmp_path: Path) -> Iterator[str]:
    """The address of a server with the one file a.pth."""
    folder = tmp_path / "site"
    folder.mkdir()
    (folder / "a.pth").write_bytes(CONTENT)
    handler = partial(SimpleHTTPRequestHandler, directory=str(folder))
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{server.server_address[1]}"
    server.shutdown()
    server.server_close()
    thread.join()


def fetched(files: tuple[WeightsFile, ...], root: Path, dry: bool = False) -> list[tuple[str, str]]:
    fetcher = Fetcher(allows=lambda url: True, attempts=1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(weights_fetch, "SINGLE_FILES", files)
        return [(i.state, i.detail) for i in download("weights", root, None if dry else fetcher, dry_run=dry)]


def test_addresses_lead_to_the_file() -> None:
    assert WeightsFile("m", "a.pth", "https://x/y/a.pth").url == "https://x/y/a.pth"
    assert WeightsFile("m", "a.pth", "https://x/y").url == "https://x/y/a.pth"
    assert (
        WeightsFile("m", "a.pth", "https://huggingface.co/u/r").url == "https://huggingface.co/u/r/resolve/main/a.pth"
    )
    for file in SINGLE_FILES:
        assert file.url.startswith("https://")
        assert file.url.endswith(f"/{file.name}")


def test_a_file_is_fetched_once_and_its_hash_is_said(site: str, tmp_path: Path) -> None:
    files = (WeightsFile("m", "a.pth", site, SHA256),)
    assert fetched(files, tmp_path, dry=True)[0] == ("missing", SHA256)
    assert fetched(files, tmp_path)[0] == ("fetched", SHA256)
    assert (tmp_path / "weights" / "a.pth").read_bytes() == CONTENT
    assert fetched(files, tmp_path)[0] == ("here", SHA256)
    assert fetched(files, tmp_path)[1][0] == "by hand"  # LLaVA


def test_what_is_not_the_published_file_is_not_kept(site: str, tmp_path: Path) -> None:
    state, why = fetched((WeightsFile("m", "a.pth", site, "0" * 64),), tmp_path)[0]
    assert (state, SHA256 in why) == ("failed", True)
    assert not (tmp_path / "weights" / "a.pth").exists()


def test_what_has_no_hash_is_named_and_not_fetched(site: str, tmp_path: Path) -> None:
    state, why = fetched((WeightsFile("m", "a.pth", site),), tmp_path)[0]
    assert (state, "no hash" in why) == ("by hand", True)
    assert not (tmp_path / "weights").exists()


def test_the_beginning_of_a_hash_is_checked_as_well(site: str, tmp_path: Path) -> None:
    assert fetched((WeightsFile("m", "a.pth", site, "0" + SHA256[1:16]),), tmp_path)[0][0] == "failed"
    assert not (tmp_path / "weights" / "a.pth").exists()
    assert fetched((WeightsFile("m", "a.pth", site, SHA256[:16]),), tmp_path)[0] == ("fetched", SHA256)


def test_every_file_that_is_fetched_has_a_hash() -> None:
    for file in SINGLE_FILES:
        assert re.fullmatch("[0-9a-f]{16}|[0-9a-f]{64}", file.expected_sha256), file.name
        named = re.search(r"-([0-9a-f]{8})\.pth$", file.name)  # torch's names begin the hash
        assert named is None or file.expected_sha256.startswith(named[1])


def test_one_file_that_is_gone_does_not_stop_the_others(site: str, tmp_path: Path) -> None:
    files = (WeightsFile("m", "gone.pth", site, SHA256), WeightsFile("m", "a.pth", site, SHA256))
    (failed, why), (state, _), _ = fetched(files, tmp_path)
    assert (failed, state) == ("failed", "fetched")
    assert "404" in why
    assert str(tmp_path / "weights" / "gone.pth") in why


def test_without_a_network_the_file_and_its_place_are_named(tmp_path: Path) -> None:
    with pytest.raises(Unavailable, match="cannot fetch") as caught:
        fetched((WeightsFile("m", "a.pth", "http://127.0.0.1:1", SHA256),), tmp_path)
    assert str(tmp_path / "weights" / "a.pth") in caught.value.allowed


def test_a_changed_file_is_found_and_a_folder_has_a_hash(tmp_path: Path) -> None:
    file = WeightsFile("m", "a.pth", "https://x", SHA256)
    file.check(tmp_path)  # nothing there, nothing wrong
    (tmp_path / "a.pth").write_bytes(CONTENT)
    file.check(tmp_path)
    (tmp_path / "a.pth").write_bytes(CONTENT + b"!")
    with pytest.raises(BadInput, match=hashlib.sha256(CONTENT + b"!").hexdigest()):
        file.check(tmp_path)
    folder = tmp_path / "model"
    (folder / "deep").mkdir(parents=True)
    (folder / "deep" / "one").write_bytes(b"1")
    lines = f"deep/one {hashlib.sha256(b'1').hexdigest()}\n"
    assert WeightsFile("m", "model", "https://x").sha256(tmp_path) == hashlib.sha256(lines.encode()).hexdigest()
