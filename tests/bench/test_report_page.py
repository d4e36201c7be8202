"""The report page in a browser: it moves, sorts and plays as it should, asks nobody, and runs nobody else's code."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from bench.report import write_report
from orca.ledger_picture import RULE_COLOURS
from tests.bench.report_run import HEIGHT, METHODS, SCENES, SCRIPT, WIDTH, write_run, write_stability
from tests.browser import Watched, open_page

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("page")
    run = write_run(folder)
    write_stability(run / "stability.json")
    return write_report(run, folder / "page.html").path


@pytest.fixture
def watched(file: Path) -> Iterator[Watched]:
    with open_page() as seen:
        seen.page.goto(file.as_uri())
        yield seen
        assert seen.errors == []
        assert [url for url in seen.requests if url != file.as_uri()] == []
        assert seen.page.evaluate("typeof pwned") == "undefined"


def column(page: Any, table: str, index: int) -> list[str]:
    found: list[str] = page.eval_on_selector_all(
        f"{table} tbody tr", f"rows => rows.map(row => row.cells[{index}].innerText.trim())"
    )
    return found


def until(page: Any, expression: str) -> None:
    """Wait for an expression to be true. (playwright's own way needs `eval`, which the page's policy forbids.)"""
    for _ in range(1200):
        if page.evaluate(expression):
            return
        page.wait_for_timeout(100)
    pytest.fail(f"not within two minutes: {expression}")


def wait_for_videos(page: Any) -> None:
    until(page, "[...document.querySelectorAll('video')].every(v => v.readyState >= 2 && !v.seeking)")


def times(page: Any) -> list[float]:
    found: list[float] = page.evaluate("[...document.querySelectorAll('video')].map(v => v.currentTime)")
    return found


def test_a_heading_sorts_its_table_up_and_down(watched: Watched) -> None:
    page = watched.page
    head = page.locator("#means thead button").nth(1)
    head.click()
    assert column(page, "#means", 0) == list(METHODS)  # best first
    head.focus()
    page.keyboard.press("Enter")
    assert column(page, "#means", 0) == list(reversed(METHODS))
    assert page.locator("#means thead th").nth(1).get_attribute("aria-sort") == "ascending"
    page.locator("#means thead button").nth(0).click()
    assert column(page, "#means", 0) == sorted(METHODS)


def test_what_has_no_number_stays_last(watched: Watched) -> None:
    page = watched.page
    heads = page.locator("#means thead button")
    index = [heads.nth(i).inner_text() for i in range(heads.count())].index("ms/frame\u00a0↓")
    for _ in range(2):
        heads.nth(index).click()
        assert column(page, "#means", 0)[0] == "orca"


def test_the_slider_divides_two_methods_at_one_frame(watched: Watched) -> None:
    page = watched.page
    wait_for_videos(page)
    page.locator(".compare").scroll_into_view_if_needed()
    box = page.locator(".compare").bounding_box()
    clip = "getComputedStyle(document.querySelectorAll('.compare video')[1]).clipPath"
    assert page.evaluate(clip) == "inset(0px 50% 0px 0px)"
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + 20)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] / 4, box["y"] + 20)
    page.mouse.up()
    assert float(page.locator("#split").input_value()) == pytest.approx(25, abs=0.5)
    page.locator("#split").focus()
    page.keyboard.press("Home")
    assert page.evaluate(clip) == "inset(0px 100% 0px 0px)"
    page.locator("#frame").fill("7")
    wait_for_videos(page)
    assert times(page) == pytest.approx([0.75] * 5)
    page.select_option("#right-method", METHODS[2])
    wait_for_videos(page)
    assert page.eval_on_selector_all(".compare video", "all => all.map(v => v.dataset.method)") == [METHODS[2], "orca"]
    assert times(page) == pytest.approx([0.75] * 5)  # the new one joins at the frame that is shown


def test_the_picture_is_that_of_the_frame(watched: Watched) -> None:
    """Read back from the decoded video: the bar of frame i is at 4 i."""
    page = watched.page
    read = """i => { const v = document.querySelectorAll('.wall video')[i], c = document.createElement('canvas');
      c.width = 64; c.height = 48; const d = c.getContext('2d'); d.drawImage(v, 0, 0, 64, 48);
      return [...d.getImageData(0, 24, 64, 1).data].filter((_, k) => k % 4 === i); }"""
    for frame in (0, 6, 11):
        page.locator("#frame").fill(str(frame))
        wait_for_videos(page)
        page.wait_for_timeout(100)
        for method in range(3):
            row = page.evaluate(read, method)
            bright = [x for x, value in enumerate(row) if value > 180]
            assert bright[0] == pytest.approx(4 * frame, abs=1)
            assert bright[-1] == pytest.approx(4 * frame + 7, abs=1)


def test_videos_play_in_step(watched: Watched) -> None:
    page = watched.page
    wait_for_videos(page)
    page.locator("#play").focus()
    page.keyboard.press("Enter")
    until(page, "Number(document.getElementById('frame').value) >= 3")
    seen = [times(page) for _ in range(20)]
    assert all(max(now) - min(now) < 1e-6 for now in seen)
    page.locator("#play").click()
    stopped = page.locator("#frame").input_value()
    page.wait_for_timeout(400)
    assert page.locator("#frame").input_value() == stopped
    assert page.locator("#play").inner_text() == "Play"


def test_scenes_by_keyboard_and_failures_in_their_place(watched: Watched) -> None:
    page = watched.page
    assert page.locator("#scene h3").first.inner_text() == SCENES[0]
    page.locator("#scene-list button").first.focus()
    page.keyboard.press("ArrowRight")
    assert page.locator("#scene h3").first.inner_text() == SCRIPT
    assert page.evaluate("document.activeElement.innerText").strip() == SCRIPT
    assert "percentile of an empty array" in page.locator(".failed").inner_text()
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("ArrowLeft")
    assert page.locator("#scene h3").first.inner_text() == SCENES[2]
    wait_for_videos(page)


def test_the_chart_tells_its_numbers(watched: Watched) -> None:
    page = watched.page
    page.locator('#chart .mean[data-method="orca"]').focus()
    assert page.locator("#tip").inner_text().split("\n") == [
        "orca",
        "PSNR, input view (dB): 31.00 [30.00, 32.00]",  # over the two scenes that every method has
        "Seconds a scene: 4.0 [4.0, 4.0]",
    ]
    page.locator('#chart .mean[data-method="warp"]').hover()
    assert "warp" in page.locator("#chart-text").inner_text()
    assert page.locator("#chart .front").get_attribute("points").count(",") == 3  # a step: warp is cheaper, orca better
    assert "2/3 scenes" in page.locator("#chart-body").inner_text()
    words = page.locator("#chart-front").inner_text()
    assert words.startswith("PSNR, input view (dB), higher is better, 2/3 scenes: 26.00 for 0.5 s with warp, then ")
    page.select_option("#chart-cost", "bytes")
    assert "no model known" in page.locator("#chart-body").inner_text()
    assert page.locator("#chart .front").count() == 0  # only one method has a model
    page.select_option("#chart-quality", "niqe")
    assert "lower is better" in page.locator("#chart-body").inner_text()
    heights = page.eval_on_selector_all(
        "#chart .mean", "all => all.map(c => [c.dataset.method, Number(c.getAttribute('cy'))])"
    )
    assert dict(heights)["orca"] < dict(heights)["warp"]  # lower is better, and better is up


def test_names_on_the_chart_keep_off_one_another(watched: Watched) -> None:
    boxes = watched.page.eval_on_selector_all(
        "#chart .name",
        "all => all.map(t => { const b = t.getBoundingClientRect(); return [b.left, b.top, b.right, b.bottom]; })",
    )
    assert len(boxes) == len(METHODS)
    for i, a in enumerate(boxes):
        for b in boxes[:i]:
            assert a[2] <= b[0] or b[2] <= a[0] or a[3] - 3 <= b[1] or b[3] - 3 <= a[1]


def test_stability_cells_say_what_happened(watched: Watched) -> None:
    page = watched.page
    page.locator("#stability td button").nth(1).click()
    assert page.locator("#stability-text").inner_text() == "all sky, warp: crash. IndexError (0.1 s)"


def pictures(page: Any, selector: str) -> list[list[int]]:
    """Width and height of the decoded pictures, once all have loaded."""
    until(page, f"[...document.querySelectorAll('{selector}')].every(i => i.complete)")
    found: list[list[int]] = page.eval_on_selector_all(
        selector, "all => all.map(i => [i.naturalWidth, i.naturalHeight])"
    )
    return found


def test_input_and_depth_are_pictures_of_every_scene(watched: Watched) -> None:
    page = watched.page
    for button in range(len(SCENES)):
        page.locator("#scene-list button").nth(button).click()
        assert pictures(page, ".stills img") == [[WIDTH, HEIGHT]] * 2
    assert pictures(page, "#scene-list img") == [[WIDTH, HEIGHT]] * 3
    assert page.locator(".stills figcaption").first.inner_text() == f"Input, {WIDTH}×{HEIGHT}"
    assert "scene radii" in page.locator(".stills figcaption").nth(1).inner_text()


def test_the_ledger_shows_what_was_missing_who_decided_and_the_view_afterwards(watched: Watched) -> None:
    """Bars, and the picture of the run's own ledger; the missing square is where the ledger says."""
    page = watched.page
    ((width, height),) = pictures(page, ".ledger img")
    assert width == 3 * 240 + 2 * 6
    assert height > 2 * 180
    assert page.locator(".ledger svg rect").count() > 4
    read = """() => { const i = document.querySelector('.ledger img'), c = document.createElement('canvas');
      c.width = i.naturalWidth; c.height = i.naturalHeight; const d = c.getContext('2d'); d.drawImage(i, 0, 0);
      const at = (x, y) => [...d.getImageData(x, y, 1, 1).data].slice(0, 3);
      const x = 20 * 240 / 64, y = 22 + 20 * 240 / 64;
      return [at(x, y), at(x + 246, y), at(x, 22 + 3 * 240 / 64)]; }"""
    missing, decided, outside = page.evaluate(read)
    assert missing == pytest.approx((255, 0, 255), abs=40)
    assert decided == pytest.approx(RULE_COLOURS["generative_min_area"], abs=40)
    assert outside != pytest.approx((255, 0, 255), abs=40)
    page.locator("#scene-list button").nth(2).click()
    assert page.locator(".ledger img").count() == 0  # that scene's run kept no picture
    assert page.locator(".ledger svg").count() == 1


def test_the_footer_says_where_the_numbers_are_from(watched: Watched) -> None:
    footer = watched.page.locator("#provenance")
    assert footer.is_visible()
    text = footer.inner_text()
    for words in (f"python -m bench run --images {SCRIPT}", "started 2026-01-02", "dataset: folder", "seed: 0"):
        assert words in text
    for words in ("cpu: a processor", "numpy 2", "warp: version 1", "NIQE: usual (1)", "asks the network for nothing"):
        assert words in text


def test_the_scores_of_a_scene_sort(watched: Watched) -> None:
    page = watched.page
    page.locator("#scene-list button").nth(2).click()
    table = "#scene table.sortable"
    head = page.locator(f"{table} thead button").nth(1)
    head.click()
    assert column(page, table, 0) == list(METHODS)
    head.click()
    assert column(page, table, 0) == list(reversed(METHODS))


def test_stability_and_failures_sort_by_every_heading(watched: Watched) -> None:
    page = watched.page
    for table in ("#stability table", "#gaps table"):
        heads = page.locator(f"{table} thead button")
        assert heads.count() >= 3
        assert page.locator(f"{table} tbody tr").count() >= 2
        for index in range(heads.count()):
            read = f"rows => rows.map(row => row.cells[{index}].dataset.value)"
            heads.nth(index).click()
            up = page.eval_on_selector_all(f"{table} tbody tr", read)
            heads.nth(index).click()
            down = page.eval_on_selector_all(f"{table} tbody tr", read)
            assert up == sorted(up, key=lambda text: (not text, text.lower())), table
            filled = [text.lower() for text in down if text]
            assert filled == sorted(filled, reverse=True), table


def test_a_finger_drags_the_slider_on_a_phone(file: Path) -> None:
    with open_page(360, 740, has_touch=True, is_mobile=True) as watched:
        page = watched.page
        page.goto(file.as_uri())
        wait_for_videos(page)
        page.locator(".compare").scroll_into_view_if_needed()
        box = page.locator(".compare").bounding_box()
        assert box["width"] <= 360
        y = box["y"] + box["height"] / 2
        touch(page, [(box["x"] + share * box["width"], y) for share in (0.5, 0.6, 0.7, 0.8)])
        assert float(page.locator("#split").input_value()) == pytest.approx(80, abs=1.5)
        clip = page.evaluate("getComputedStyle(document.querySelectorAll('.compare video')[1]).clipPath")
        assert float(clip.split("(")[1].split()[1].strip("%")) == pytest.approx(20, abs=1.5)
        assert watched.errors == []


def touch(page: Any, points: list[tuple[float, float]]) -> None:
    """One finger down at the first point, along the others, and up: through the browser's own input, not the page's."""
    session = page.context.new_cdp_session(page)
    for i, (x, y) in enumerate(points):
        kind = "touchMove" if i else "touchStart"
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [{"x": x, "y": y}]})
    session.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})


def test_nothing_hangs_over_the_side_of_a_phone(file: Path) -> None:
    with open_page(360, 740, color_scheme="dark", has_touch=True, is_mobile=True) as watched:
        page = watched.page
        page.goto(file.as_uri())
        wait_for_videos(page)
        assert page.evaluate("document.documentElement.scrollWidth") <= 360
        light = page.evaluate("getComputedStyle(document.body).backgroundColor")
        assert light == "rgb(21, 24, 27)"
        page.locator("#play").tap()
        until(page, "Number(document.getElementById('frame').value) >= 1")
        assert watched.errors == []
