"""Programs of the system that some tests need: without them a test is skipped, unless CI says that they are there."""

from __future__ import annotations

import os
import shutil
from typing import NoReturn

import pytest

__all__ = ["REQUIRED", "missing", "need_programs"]

REQUIRED = "ORCA_REQUIRE_BROWSER"  # `.ci/run` sets it to 1 once browser, LaTeX and poppler are installed


def missing(what: str) -> NoReturn:
    """Skip the test that needs it; fail it where `REQUIRED` is set, so that nothing goes untested unnoticed."""
    if os.environ.get(REQUIRED, "0") not in ("", "0"):
        pytest.fail(f"{what}, and {REQUIRED} is set", pytrace=False)
    pytest.skip(what)


def need_programs(*names: str) -> None:
    """Skip, or fail, unless all of these are on the path."""
    absent = [name for name in names if shutil.which(name) is None]
    if absent:
        missing(f"no {' and no '.join(absent)} on the path")
