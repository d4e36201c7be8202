"""Is a run still what was measured? Seals, stored frames, cameras and inputs; every fault names a file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.datasets import open_dataset
from bench.datasets.case import Dataset, SceneCase
from bench.digest import broken_seals, is_sealed
from bench.frames import load_frames
from bench.provenance import case_hashes, file_sha256, output_hashes
from bench.record import CellRecord
from bench.store import RunStore, read_json
from orca.errors import BadInput, OrcaError

__all__ = ["Fault", "Verification", "verify_run"]


@dataclass(frozen=True)
class Fault:
    """What is wrong with one file.

    Attributes:
        file: the file, as a path that can be opened.
        kind: "edited", "unreadable", "missing", "frames", "cameras" or "stale".
        what: in words.
    """

    file: str
    kind: str
    what: str


@dataclass(frozen=True)
class Verification:
    """What was looked at and what was found.

    Attributes:
        records: how many results were checked.
        inputs: how many scenes' inputs were hashed anew.
        faults: everything that is wrong; empty for a run that stands.
        notes: what could not be checked, and why.
    """

    records: int
    inputs: int
    faults: tuple[Fault, ...]
    notes: tuple[str, ...]


def verify_run(root: Path, data_root: Path | None = None, frames: bool = True) -> Verification:
    """Check a run folder.

    Args:
        root: the folder.
        data_root: where the data set lies now; where it lay when it ran, if left out.
        frames: decode the stored frames and compare their pixels too.

    Raises:
        BadInput: no run there.
    """
    store = RunStore(root)
    if not store.run_path.is_file():
        raise BadInput(f"no run in '{root}'", "a folder that holds run.json", "name the folder of a run")
    faults: list[Fault] = []
    notes: list[str] = []
    records = dict(_read_all(store, faults, notes))
    for path, record in records.items():
        faults += _record_faults(store, path, record, frames)
    inputs = _Inputs(store, data_root, faults, notes)
    inputs.check(records)
    return Verification(len(store.record_paths()), inputs.checked, tuple(faults), tuple(notes))


def _read_all(store: RunStore, faults: list[Fault], notes: list[str]) -> Iterator[tuple[Path, CellRecord]]:
    """Results that can be read; faults of their seals, and of run.json's, go into ``faults``."""
    unsealed = []
    for path in (store.run_path, *store.record_paths()):
        try:
            document = read_json(path)
            record = None if path == store.run_path else CellRecord.from_json(document, str(path))
        except BadInput as error:
            faults.append(Fault(str(path), "unreadable", error.given))
            continue
        if not is_sealed(document):
            unsealed.append(path)
        elif parts := broken_seals(document):
            faults.append(Fault(str(path), "edited", f"its {' and its '.join(parts)} is not what was written"))
        if record is not None:
            yield path, record
    if unsealed:
        notes.append(f"{len(unsealed)} files without a seal (schema version 1): an edit of them cannot be seen")


def _record_faults(store: RunStore, path: Path, record: CellRecord, frames: bool) -> Iterator[Fault]:
    """What one result says of itself against the files beside it."""
    if (record.method, record.scene) != (path.parent.name, path.stem):
        yield Fault(str(path), "edited", f"it holds the result of {record.method} on {record.scene}")
        return
    if record.failure is not None:
        return
    cameras = store.root / "trajectories" / f"{record.trajectory_sha256}.json"
    yield from _trajectory_faults(store, cameras, record)
    stored = store.frames_path(record.method, record.scene)
    if not stored.is_file():
        yield Fault(str(stored), "missing", "the scored frames are gone; the scores cannot be computed again")
    elif frames:
        output = load_frames(stored, record)
        if output is None:
            yield Fault(str(stored), "frames", "its pixels are not those that were scored")
        elif record.views and output_hashes(output) != record.views:
            changed = [k for k in record.views if output_hashes(output).get(k) != record.views[k]]
            yield Fault(str(stored), "frames", f"its {', '.join(changed) or 'views'} are not those that were scored")


def _trajectory_faults(store: RunStore, path: Path, record: CellRecord) -> Iterator[Fault]:
    try:
        trajectory = store.load_trajectory(record.trajectory_sha256 or "")
    except BadInput as error:
        yield Fault(str(path), "unreadable", error.given)
        return
    if trajectory is None:
        yield Fault(str(path), "missing", f"the cameras of {record.method} on {record.scene} are gone")
    elif trajectory.sha256 != record.trajectory_sha256:
        yield Fault(
            str(path), "cameras", f"it holds other cameras (SHA-256 {trajectory.sha256[:12]}) than its name says"
        )


class _Inputs:
    """The scenes of a run, loaded anew and compared with what each result was made from."""

    def __init__(self, store: RunStore, data_root: Path | None, faults: list[Fault], notes: list[str]) -> None:
        self.checked = 0
        self._store, self._faults, self._notes = store, faults, notes
        run = _load_run(store)
        self._identity: Mapping[str, Any] = run.get("identity", {})
        before = run.get("folders", {}).get("data_root")
        self._root = data_root or (None if before is None else Path(before))
        images = self._identity.get("images")
        self._images = None if images is None else Path(images)

    def check(self, records: Mapping[Path, CellRecord]) -> None:
        """Add a fault for every result of which an input is another one now."""
        known = {path: record for path, record in records.items() if record.inputs}
        if len(known) < len(records):
            self._notes.append(
                f"{len(records) - len(known)} results name no inputs (schema version 1, or never loaded)"
            )
        dataset = self._open() if known else None
        for scene in dict.fromkeys(record.scene for record in known.values()):
            case = None if dataset is None else self._load(dataset, scene)
            mine = {path: record for path, record in known.items() if record.scene == scene}
            for path, record in mine.items():
                stale_files = self._stale_files(record)
                self._faults += [Fault(str(f), "stale", f"{what} since {path} was made") for f, what in stale_files]
                if case is not None:
                    self._faults += _stale_parts(path, record, case)

    def _open(self) -> Dataset | None:
        try:
            return open_dataset(
                str(self._identity.get("dataset")),
                data_root=self._root,
                images=self._images,
                trajectory=self._identity.get("trajectory"),
            )
        except OrcaError as error:
            self._notes.append(f"inputs were not decoded: {error.given}; {error.fix}")
            return None

    def _load(self, dataset: Dataset, scene: str) -> SceneCase | None:
        try:
            case = dataset.load(scene)
        except OrcaError as error:
            self._faults.append(
                Fault(f"scene {scene} of {dataset.name}", "stale", f"it cannot be loaded: {error.given}")
            )
            return None
        self.checked += 1
        return case

    def _stale_files(self, record: CellRecord) -> Iterator[tuple[Path, str]]:
        roots = [root for root in (self._root, self._images) if root is not None]
        for name, known in record.inputs.get("files", {}).items():
            paths = [root / name for root in roots]
            found = next((path for path in paths if path.is_file()), None)
            if found is None:
                yield (paths or [Path(name)])[0], "it is gone"
            elif file_sha256(found) != known:
                yield found, "it changed"


def _stale_parts(path: Path, record: CellRecord, case: SceneCase) -> list[Fault]:
    now = case_hashes(case)
    parts = [part for part, known in record.inputs.items() if part != "files" and now.get(part) != known]
    what = f"the {', '.join(parts)} of scene {case.name} in data set {case.dataset} changed since it was made"
    return [Fault(str(path), "stale", what)] if parts else []


def _load_run(store: RunStore) -> dict[str, Any]:
    try:
        return store.load_run() or {}
    except BadInput:  # already a fault of its own
        return {}
