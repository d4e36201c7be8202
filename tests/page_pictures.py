"""Pictures of a report page, at two widths: ``python -m tests.page_pictures PAGE.html FOLDER``.

desktop-*.webp are 1280x900 in light colours, 960 pixels wide as kept; phone-*.webp 390x844 in dark ones. What the page
wrote to the console and whom it asked is printed; both should be nothing.
"""

from __future__ import annotations

import argparse
import io
from pathlib import Path
from typing import Any

from tests.browser import open_page

_SIZES = {"desktop": (1280, 900, "light", 960), "phone": (390, 844, "dark", 390)}
_PLACES = {"scores": "#means", "chart": "#chart", "scene": "#scenes", "wall": "#play", "stability": "#stability"}

_MOVE = """const frame = document.querySelector("#frame");
if (frame) { frame.value = Math.round(frame.max / 3); frame.dispatchEvent(new Event("input")); }"""


def main() -> None:
    """Take the pictures."""
    parser = argparse.ArgumentParser(prog="python -m tests.page_pictures", description=__doc__.splitlines()[0])
    parser.add_argument("page", type=Path, metavar="PAGE", help="HTML file that `bench report` wrote")
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="where the pictures go")
    args = parser.parse_args()
    args.folder.mkdir(parents=True, exist_ok=True)
    address = args.page.resolve().as_uri()
    for name, (width, height, scheme, kept) in _SIZES.items():
        with open_page(width, height, color_scheme=scheme) as seen:
            seen.page.goto(address)
            seen.page.wait_for_timeout(3000)
            seen.page.evaluate(_MOVE)
            for place, selector in _PLACES.items():
                if _show(seen.page, selector):
                    _keep(seen.page.screenshot(), kept, args.folder / f"{name}-{place}.webp")
        print(f"{name}: console {seen.errors}, asked {[url for url in seen.requests if url != address]}")


def _show(page: Any, selector: str) -> bool:
    """Scroll to a part of the page; whether it is there."""
    if page.locator(selector).count() == 0:
        return False
    page.evaluate(f"document.querySelector('{selector}').scrollIntoView(true)")
    page.wait_for_timeout(4000)  # videos and pictures
    return True


def _keep(png: bytes, width: int, path: Path) -> None:
    """As a small file."""
    from PIL import Image

    picture = Image.open(io.BytesIO(png)).convert("RGB")
    picture = picture.resize((width, round(picture.height * width / picture.width)), Image.Resampling.LANCZOS)
    picture.save(path, "WEBP", quality=60, method=6)


if __name__ == "__main__":
    main()
