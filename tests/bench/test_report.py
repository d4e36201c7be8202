"""The report page as a file: what is in it, what is escaped, how large it gets, what it says is missing."""

from __future__ import annotations

import base64
import json
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.cli import main
from bench.report import write_report
from bench.report.collect import as_script
from bench.report.media import RUNGS, depth_picture, encode_video, fitted, webp
from bench.report.stability import find_stability, read_stability
from bench.store import RunStore
from orca.errors import BadInput
from orca.video import read_video
from tests.bench.report_run import FRAMES, HEIGHT, IMAGE, METHODS, SCENES, SCRIPT, WIDTH, write_run, write_stability


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_run(tmp_path_factory.mktemp("report"))


@pytest.fixture(scope="module")
def page(run: Path) -> str:
    write_stability(run / "stability.json")
    report = write_report(run, run / "page.html")
    assert (report.scenes, report.video, report.missing) == (3, RUNGS[0], ())
    assert report.num_bytes == (run / "page.html").stat().st_size
    return (run / "page.html").read_text()


class Elements(HTMLParser):
    """Every element with its attributes, and the text of the scripts that are data."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))


def data_of(page: str) -> dict[str, Any]:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    document: dict[str, Any] = json.loads(found[1])
    return document


def test_names_are_text_everywhere(page: str) -> None:
    tags = Elements(page).tags
    assert [t for t, _ in tags].count("img") == 0  # pictures are made by the script, from blobs
    assert not [a for _, a in tags if any(key.startswith("on") for key in a)]
    scripts = [a for t, a in tags if t == "script"]
    assert [a for a in scripts if "type" not in a] == [{}]  # the page's own and no other
    assert not [t for t, _ in tags if t in ("b", "i", "iframe", "object")]
    assert SCRIPT not in page
    assert IMAGE not in page
    assert "&lt;script&gt;pwned=1" in page
    assert [scene["name"] for scene in data_of(page)["scenes"]] == list(SCENES)


def test_only_its_own_script_and_style_may_run(page: str) -> None:
    policy = re.search(r'Content-Security-Policy" content="([^"]+)"', page)
    assert policy is not None
    assert "default-src 'none'" in policy[1]
    assert "unsafe" not in policy[1]
    assert policy[1].count("sha256-") == 2
    assert not re.findall(r'(?:src|href)="(?:https?:)?//', page)


def test_a_script_element_cannot_be_closed_from_within() -> None:
    text = as_script({"</script>": "<!-- & \u2028", "inf": float("inf"), "nan": float("nan")})
    assert not set("<>&\u2028") & set(text)
    assert json.loads(text) == {"</script>": "<!-- & \u2028", "inf": "inf", "nan": None}


def test_numbers_and_reasons_are_those_of_the_records(page: str) -> None:
    data = data_of(page)
    keys = [column["key"] for column in data["columns"]]
    assert keys == ["input_psnr", "niqe", "seconds", "render_ms_per_frame", "anchors", "bytes"]  # no column of gaps
    first = data["scenes"][0]
    assert first["values"]["orca"] == {
        **{"input_psnr": 30.0, "niqe": 3.0, "seconds": 4.0, "render_ms_per_frame": 20.0},
        **{"anchors": 900.0, "bytes": 4.0},
    }
    assert data["scenes"][1]["failures"]["warp"].startswith("crash in method: IndexError")
    assert "warp" not in data["scenes"][1]["values"]
    assert [r["decision"] for r in first["ledgers"]["orca"]["repairs"]] == ["local", "generative"]
    assert data["scenes"][1]["ledgers"]["orca"]["repairs"] is None
    assert "no &lt;script&gt;pwned=1 weights; get them" in page
    assert "percentile of an empty array" in page
    for fact in ("2026-01-02T03:04:05+00:00", "a processor", "all pixels (1)", "numpy 2"):
        assert fact in page


def test_videos_hold_the_frames(page: str, tmp_path: Path) -> None:
    media = re.findall(r'<script type="text/plain" id="media-(\d+)" data-mime="([^"]+)">([^<]+)</script>', page)
    assert [int(index) for index, _, _ in media] == list(range(len(media)))
    assert [mime for _, mime, _ in media].count("video/mp4") == len(SCENES) * len(METHODS) - 1
    assert [mime for _, mime, _ in media].count("image/webp") == 2 * len(SCENES) + 1  # input, depth; a ledger
    entry = data_of(page)["scenes"][0]
    (tmp_path / "v.mp4").write_bytes(base64.b64decode(media[entry["videos"]["orca"]][2]))
    frames = read_video(tmp_path / "v.mp4").astype(int)
    assert frames.shape == (FRAMES, HEIGHT, WIDTH, 3)
    for i in (0, 5, 11):
        assert frames[i, 24, 4 * i + 4, 0] > 180  # the bar, in its place


def test_videos_shrink_until_the_page_fits(run: Path, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 256, (20, 256, 256, 3), dtype=np.uint8)
    sizes = [len(encode_video(noise, *rung)) for rung in RUNGS]
    assert sizes == sorted(sizes, reverse=True)
    whole = write_report(run, tmp_path / "a.html").num_bytes
    with pytest.raises(BadInput, match="with the smallest videos"):
        write_report(run, tmp_path / "b.html", max_bytes=whole // 4)
    assert not (tmp_path / "b.html").exists()


def test_what_is_not_there_is_said(run: Path, tmp_path: Path) -> None:
    copy = write_run(tmp_path)
    RunStore(copy).frames_path("orca", "plain").unlink()
    (tmp_path / "images" / "plain.png").unlink()
    report = write_report(copy, tmp_path / "page.html")
    assert any("frames of orca on plain" in line for line in report.missing)
    assert any("plain" in line for line in report.missing if "input" in line)
    data = data_of((tmp_path / "page.html").read_text())
    assert "orca" not in data["scenes"][0]["videos"]
    assert "input" not in data["scenes"][0]
    assert data["scenes"][0]["values"]["orca"]["input_psnr"] == 30.0


def test_the_verb(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "page.html"
    assert main(["report", str(run), "--out", str(out), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert (answer["page"], answer["bytes"], answer["scenes"]) == (str(out), out.stat().st_size, 3)
    assert main(["report", str(tmp_path / "none")]) == 2
    assert main(["report", str(run), "--max-mb", "0"]) == 2
    assert "error" in capsys.readouterr().err


def test_stability_is_found_and_read(run: Path, tmp_path: Path) -> None:
    path = write_stability(run / "stability.json")
    assert find_stability(run) == path
    matrix = read_stability(path)
    assert matrix["methods"] == ["orca", "warp"]
    assert [row["case"] for row in matrix["rows"]] == ["all sky", SCRIPT]
    assert [cell["class"] for cell in matrix["rows"][0]["cells"]] == ["fair", "bad"]
    assert matrix["totals"] == ["1 degraded, 1 exact", "1 crash, 1 <i>odd</i>"]
    assert matrix["rows"][0]["cells"][0]["seconds"] == "2.5 s"
    assert find_stability(tmp_path / "elsewhere") is None
    for text in ("[", '{"cases": []}', '[{"case": "x"}]', "[1]"):
        (tmp_path / "broken.json").write_text(text)
        with pytest.raises(BadInput, match="broken"):
            read_stability(tmp_path / "broken.json")


def test_depth_is_bright_where_it_is_near() -> None:
    depth = np.full((20, 20), 4.0, np.float32)
    depth[:, 10:] = 1.0
    depth[0, 0] = np.nan
    picture, near, far = depth_picture(depth)
    assert (near, far) == (1.0, 4.0)
    assert picture[5, 15].sum() > 500 > 100 > picture[5, 5].sum()
    assert picture[0, 0].tolist() == [0, 0, 0]
    assert not depth_picture(np.zeros((4, 4), np.float32))[0].any()


def test_stills_fit() -> None:
    assert fitted(np.zeros((1000, 500, 3), np.uint8), 512).shape == (512, 256, 3)
    assert fitted(np.zeros((10, 20, 3), np.uint8), 512).shape == (10, 20, 3)
    assert webp(np.zeros((10, 20, 3), np.uint8))[8:12] == b"WEBP"


def test_a_ledger_that_cannot_be_drawn_is_said_and_a_page_made(tmp_path: Path) -> None:
    run = write_run(tmp_path)
    scene = run / "work" / "orca" / "plain" / "scene.safetensors"
    scene.write_bytes(b"no scene")
    report = write_report(run, tmp_path / "page.html")
    assert [line.partition(":")[0] for line in report.missing] == ["ledger picture of orca on plain"]
    scene.unlink()
    assert write_report(run, tmp_path / "page.html").missing == ()  # runs need not keep their scenes
