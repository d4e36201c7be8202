"""What two runs must have in common: every file, byte for byte, apart from timing and host."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

from bench.digest import broken_seals, unsealed
from bench.record import CellRecord

__all__ = ["finished_cells", "half_written", "snapshot"]


def snapshot(root: Path) -> dict[str, Any]:
    """Path -> content of every file below ``root``, hidden ones too; of JSON objects without seal, timing and host."""
    return {path.relative_to(root).as_posix(): _content(path) for path in sorted(root.rglob("*")) if path.is_file()}


def _content(path: Path) -> Any:
    content = path.read_bytes()
    if path.suffix != ".json":
        return content
    document = json.loads(content)
    lasting = {key: value for key, value in unsealed(document).items() if key not in ("timing", "host")}
    return json.dumps(lasting).replace(str(path.parents[1]), "RUN")


def half_written(root: Path) -> list[str]:
    """Every file that has its name and is not whole: JSON that does not parse or match its seal, a broken archive."""
    broken = []
    for path in sorted(p for p in root.rglob("*") if p.is_file() and not p.name.startswith(".")):
        content = path.read_bytes()
        if path.suffix == ".json":
            try:
                document = json.loads(content)
                bad = bool("digest" in document and broken_seals(document))
            except ValueError:
                bad = True
        elif path.suffix == ".npz":
            bad = not zipfile.is_zipfile(path) or zipfile.ZipFile(path).testzip() is not None
        elif path.suffix == ".parquet":
            bad = content[:4] != b"PAR1" or content[-4:] != b"PAR1"
        else:
            bad = not content
        if bad:
            broken.append(path.relative_to(root).as_posix())
    return broken


def finished_cells(root: Path, sound: bool = False) -> dict[tuple[str, str], set[str]]:
    """(method, scene) -> metrics of every result that is there now; with ``sound`` of those without a failure."""
    records = [
        CellRecord.from_json(json.loads(path.read_text()), str(path))
        for path in root.glob("scenes/*/*.json")
        if not path.name.startswith(".")
    ]
    kept = (record for record in records if not (sound and record.any_failed))
    return {(record.method, record.scene): set(record.scores) for record in kept}
