"""Fetches one public file: https only, resumed where it broke off, checked by SHA-256, whole or not there at all."""

from __future__ import annotations

import fcntl
import hashlib
import http.client
import os
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any
from urllib.parse import urlsplit

from orca.atomic import output_folder
from orca.errors import BadInput, Unavailable
from orca.faults import fault_point

__all__ = ["Fetcher", "Progress", "is_https", "sha256_of"]

Progress = Callable[[int, int], None]  # bytes so far, bytes in all
_CHUNK = 1 << 20


def is_https(url: str) -> bool:
    """Whether a URL may be fetched: https and a host."""
    parts = urlsplit(url)
    return parts.scheme == "https" and bool(parts.hostname)


def sha256_of(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@dataclass(frozen=True)
class Fetcher:
    """How files are fetched.

    Attributes:
        allows: says of a URL, also of each one redirected to, whether it may be used.
        timeout: seconds without a byte.
        attempts: how often one file is tried; each goes on where the one before broke off.
        pause: seconds before the second attempt, doubled before each later one.
    """

    allows: Callable[[str], bool] = is_https
    timeout: float = 30.0
    attempts: int = 4
    pause: float = 1.0

    def fetch(
        self, url: str, target: Path, sha256: str | None, max_bytes: int, progress: Progress = lambda done, total: None
    ) -> None:
        """Fetch ``url`` to ``target``, which appears only when all of it is there and its hash is right.

        What an interrupted fetch got stays in ``.<name>.part`` beside the target and is gone on from.

        Args:
            url: where the file is.
            target: where it goes; its folder is made.
            sha256: of the whole file, or what it begins with; None only for a caller that checks the content itself.
            max_bytes: the file's size if known, else a bound; more is never written.
            progress: hears of it.

        Raises:
            BadInput: a URL that may not be used, or a file with another hash: it is not kept.
            Unavailable: no network, or the server does not give the file; says where the file goes by hand.
        """
        if not self.allows(url):
            raise BadInput(f"the address {url}", "https", "name another source")
        output_folder(target.parent)
        part = target.with_name(f".{target.name}.part")
        with _locked(part) as file:
            self._attempt_all(url, target, file, max_bytes, sha256, progress)
            file.flush()
            os.fsync(file.fileno())
            found = sha256_of(part)
            if sha256 is not None and not (sha256 and found.startswith(sha256)):
                part.unlink()
                raise BadInput(
                    f"{url} has SHA-256 {found}", f"{sha256}", "the public file has changed, or was tampered with"
                )
            fault_point("written", target)
            os.replace(part, target)
            fault_point("named", target)

    def _attempt_all(
        self, url: str, target: Path, file: IO[bytes], max_bytes: int, sha256: str | None, progress: Progress
    ) -> None:
        for attempt in range(self.attempts):
            try:
                if attempt:
                    time.sleep(self.pause * 2 ** (attempt - 1))
                return self._attempt(url, file, max_bytes, progress)
            except urllib.error.HTTPError as error:
                if error.code == 416:  # the part is no beginning of that file
                    file.truncate(0)
                elif error.code < 500 and error.code != 429:
                    raise _unavailable(url, target, sha256, f"the server says {error.code}") from error
                why: Exception = error
            except (OSError, http.client.HTTPException) as error:  # URLError, time-outs and resets are OSErrors
                why = error
        raise _unavailable(url, target, sha256, str(getattr(why, "reason", why)) or type(why).__name__) from why

    def _attempt(self, url: str, file: IO[bytes], max_bytes: int, progress: Progress) -> None:
        have = file.seek(0, os.SEEK_END)
        headers = {"User-Agent": "orca-bench", "Accept-Encoding": "identity"}
        if have:
            headers["Range"] = f"bytes={have}-"
        request = urllib.request.Request(url, headers=headers)
        with _opener(self.allows).open(request, timeout=self.timeout) as response:
            resumed = response.status == 206 and _range_start(response.headers.get("Content-Range", "")) == have
            if have and not resumed:
                file.truncate(0)
                have = file.seek(0, os.SEEK_END)
            length = response.headers.get("Content-Length", "")
            total = have + int(length) if length.isdecimal() else max_bytes
            if total > max_bytes:
                raise _too_large(url, total, max_bytes)
            while chunk := response.read(_CHUNK):
                have += len(chunk)
                if have > max_bytes:
                    file.truncate(0)
                    raise _too_large(url, have, max_bytes)
                file.write(chunk)
                progress(have, total)
            if length.isdecimal() and have < total:
                raise http.client.IncompleteRead(b"", total - have)


def _range_start(header: str) -> int:
    """First byte of ``Content-Range: bytes 5-9/10``, -1 if there is none."""
    unit, _, rest = header.partition(" ")
    first = rest.partition("-")[0]
    return int(first) if unit == "bytes" and first.isdecimal() else -1


class _CheckedRedirects(urllib.request.HTTPRedirectHandler):
    """Follows a redirect only to an address that may be used."""

    def __init__(self, allows: Callable[[str], bool]) -> None:
        self._allows = allows

    def redirect_request(self, req: Any, fp: Any, code: int, msg: str, headers: Any, newurl: str) -> Any:
        if not self._allows(newurl):
            raise BadInput(f"{req.full_url} leads to {newurl[:200]}", "https", "name another source")
        return super().redirect_request(req, fp, code, msg, headers, newurl)


def _opener(allows: Callable[[str], bool]) -> urllib.request.OpenerDirector:
    return urllib.request.build_opener(_CheckedRedirects(allows))


@contextmanager
def _locked(part: Path) -> Iterator[IO[bytes]]:
    """The partial file, for appending, held by this process alone."""
    with part.open("ab") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise BadInput(f"{part} is in use", "one download of a file at a time", "wait for the other") from error
        try:
            yield file
        finally:
            if part.is_file() and not os.fstat(file.fileno()).st_size:  # nothing to go on from
                part.unlink()


def _too_large(url: str, size: int, limit: int) -> BadInput:
    return BadInput(f"{url} of {size} bytes or more", f"{limit}", "the public file has changed: do not use it")


def _unavailable(url: str, target: Path, sha256: str | None, why: str) -> Unavailable:
    check = f", SHA-256 {sha256}" if sha256 else ""
    return Unavailable(
        f"cannot fetch {url}: {why}",
        f"the file {target}{check}",
        "with no network here: fetch it on another machine and put it there; else run the same command again, which "
        "goes on from where it stopped",
    )
