"""A headless browser for tests of pages; where there is none they are skipped, or fail (see `tests.programs`)."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from tests.programs import missing

__all__ = ["Watched", "open_page"]

_NAMES = ("chromium", "chromium-browser", "google-chrome")
_QUIET = ("--no-sandbox", "--disable-background-networking", "--disable-component-update", "--no-first-run")
_SOFTWARE_GL = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")


@dataclass
class Watched:
    """A page, and what it did that it should not.

    Attributes:
        page: playwright's page.
        errors: console errors and uncaught exceptions.
        requests: every request that is not for data in the page itself.
    """

    page: Any
    errors: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)

    def asked(self, url: str) -> None:
        """Take note of a request, unless it is for data in the page itself."""
        if not url.startswith(("data:", "blob:")):
            self.requests.append(url)


@contextmanager
def open_page(width: int = 1100, height: int = 800, webgl: bool = False, **options: Any) -> Iterator[Watched]:
    """A fresh page of Debian's chromium (or another of its names on the path)."""
    found = next((path for name in _NAMES if (path := shutil.which(name))), None)
    if found is None:
        missing("no chromium on the path")
    try:
        from playwright import sync_api
    except ImportError:
        missing("playwright is not installed")
    with sync_api.sync_playwright() as play:
        flags = [*_QUIET, *(_SOFTWARE_GL if webgl else ("--disable-gpu",))]
        browser = play.chromium.launch(executable_path=found, args=flags)
        page = browser.new_page(viewport={"width": width, "height": height}, **options)
        page.set_default_timeout(120_000)  # a busy machine is no failure
        watched = Watched(page)
        page.on("console", lambda message: watched.errors.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: watched.errors.append(str(error)))
        page.on("request", lambda request: watched.asked(request.url))
        try:
            yield watched
        finally:
            browser.close()
