"""Reads JSON that somebody else wrote: of a bounded size, and any damage is one typed error."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from orca.errors import BadInput

__all__ = ["MAX_BYTES", "parse_json", "read_json_file"]

MAX_BYTES = 64 * 2**20


def read_json_file(path: Path, allowed: str, fix: str = "check the file", max_bytes: int = MAX_BYTES) -> Any:
    """The content of a JSON file, looked at by nobody yet.

    Args:
        path: the file.
        allowed: what belongs there, for the error.
        fix: what to do about it, likewise.
        max_bytes: of the file; more is refused before it is read.

    Raises:
        BadInput: no such file, too large, not text, or not JSON.
    """
    try:
        size = path.stat().st_size
        if size > max_bytes:
            raise BadInput(f"{path} of {size} bytes", f"at most {max_bytes} bytes: {allowed}", fix)
        return parse_json(path.read_bytes(), str(path), allowed, fix)
    except OSError as error:
        raise BadInput(f"{path} cannot be read ({error.strerror or error})", allowed, fix) from error


def parse_json(content: bytes | str, what: str, allowed: str, fix: str = "check the file") -> Any:
    """JSON from memory; raises `BadInput`, which names ``what``, for anything else and for nesting without end."""
    try:
        text = content if isinstance(content, str) else content.decode("utf-8-sig")
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise BadInput(f"{what} is not JSON ({error})", allowed, fix) from error
