"""Shared by all tests: the real data, when it is here."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

# Tests look at no model of the machine they run on, and download none.
os.environ["HF_HUB_OFFLINE"] = "1"
os.environ["HF_HUB_CACHE"] = os.path.join(os.path.dirname(__file__), "no-hub-cache")


@pytest.fixture(scope="session")
def data_root() -> Path:
    """The real data of ORCA_DATA_ROOT; tests that need it are skipped without it."""
    root = os.environ.get("ORCA_DATA_ROOT")
    if not root or not Path(root).is_dir():
        pytest.skip("real data not here: set ORCA_DATA_ROOT to a folder with realmdreamer/ and vistadream/")
    return Path(root)
