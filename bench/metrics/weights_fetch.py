"""Fetches the weights of the learned metrics: each file from its publisher, over https, whole, its hash checked."""

from __future__ import annotations

import urllib.error
from collections.abc import Callable
from pathlib import Path

from bench.datasets.fetch import Fetcher, sha256_of
from bench.metrics.clip_iqa import CLIP_RN50
from bench.metrics.llava import BAKLLAVA
from bench.metrics.lpips import LPIPS_ALEX
from bench.metrics.musiq import MUSIQ_KONIQ
from bench.metrics.niqe import NIQE_PRIOR
from bench.metrics.weights import WeightsFile
from orca.errors import BadInput, Unavailable

__all__ = ["SINGLE_FILES", "fetch_weights"]

SINGLE_FILES = (NIQE_PRIOR, MUSIQ_KONIQ, CLIP_RN50, LPIPS_ALEX.trunk, LPIPS_ALEX.heads)
MAX_BYTES = 512 * 2**20

Report = Callable[[str, int, int], None]


def fetch_weights(
    folder: Path, fetcher: Fetcher | None, report: Report = lambda name, done, total: None
) -> list[tuple[Path, str, str, str]]:
    """Fetch what is missing of `SINGLE_FILES` into a folder; name the folder of LLaVA, which is too large for this.

    Args:
        folder: the folder of weights.
        fetcher: how; None to say only what would be fetched.
        report: hears of progress as (file name, bytes, bytes in all).

    Returns:
        For each file where it is or belongs, its state ("here", "fetched", "missing", "by hand" or "failed"), its
        address, and its hash or what went wrong.

    Raises:
        Unavailable: no network; what was fetched before stays.
    """
    found = [(folder / file.name, *_fetch(file, folder, fetcher, report)) for file in SINGLE_FILES]
    path = folder / BAKLLAVA.name
    how = (
        f"15 GB, no hash of it is known, so it is not fetched: hf download {BAKLLAVA.name} --local-dir {path}; "
        "or use a server (bench run --llava-url)"
    )
    return [*found, (path, "here" if path.is_dir() else "by hand", BAKLLAVA.source, how)]


def _fetch(file: WeightsFile, folder: Path, fetcher: Fetcher | None, report: Report) -> tuple[str, str, str]:
    path = folder / file.name
    try:
        if path.is_file():
            file.check(folder)
            return "here", file.url, sha256_of(path)
        pinned = file.expected_sha256
        if not pinned:
            return "by hand", file.url, "no hash of it is known, so it is not fetched: look at it, and put it there"
        if fetcher is None:
            return "missing", file.url, pinned
        fetcher.fetch(file.url, path, pinned, MAX_BYTES, lambda done, total: report(file.name, done, total))
        return "fetched", file.url, sha256_of(path)
    except Unavailable as error:
        if not isinstance(error.__cause__, urllib.error.HTTPError):
            raise  # no network: the other files would fail the same way
        return "failed", file.url, str(error)
    except BadInput as error:
        return "failed", file.url, str(error)
