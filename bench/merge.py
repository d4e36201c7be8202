"""Parts of one run, computed anywhere, put together in one folder; a contradiction is an error and writes nothing."""

from __future__ import annotations

import filecmp
import json
import shutil
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import reduce
from pathlib import Path
from typing import Any, TypeVar

from bench.adapters import METHODS
from bench.datasets import open_dataset
from bench.digest import broken_seals, is_sealed
from bench.join import Conflict, canonical, joined_records, joined_runs, own_timing
from bench.metrics import METRICS
from bench.plan import in_order
from bench.provenance import file_sha256
from bench.record import CellRecord
from bench.runner import keep_summary
from bench.store import RunStore, read_json, write_atomic
from orca.atomic import atomic_path
from orca.errors import BadInput, OrcaError

__all__ = ["Merged", "merge_runs"]

T = TypeVar("T")


@dataclass(frozen=True)
class Merged:
    """What came together.

    Attributes:
        runs: folders that were read, ``out`` among them if it held a run.
        results: cells in ``out`` now.
        several: of these, cells that more than one run had.
    """

    runs: tuple[Path, ...]
    results: int
    several: int


def merge_runs(
    out: Path, roots: Sequence[Path], methods: Iterable[str] = METHODS, metrics: Iterable[str] = METRICS
) -> Merged:
    """Put the results of several runs into ``out``; one that lies there already is one of them.

    Which run is named first, and how often, makes no difference (`bench.join`). Everything is read and compared before
    anything is written; a result is written after the files that belong to it.

    Args:
        out: folder, new or of a run.
        roots: folders of runs over one data set with one preset, seed, trajectory, device and codec.
        methods, metrics: names in the order of their rows and columns.

    Raises:
        BadInput: no run in a folder; a file that was changed after it was written; two runs that contradict each other:
            both files are named.
        CannotWrite: the folder is read-only or full.
    """
    target = RunStore(out)
    here = [out] if target.run_path.is_file() else []
    stores = [RunStore(root) for root in dict.fromkeys(Path(root).resolve() for root in (*here, *roots))]
    run = _joined([(store.run_path, _run_of(store)) for store in stores], joined_runs)
    cells: dict[tuple[str, str], list[RunStore]] = {}
    for store in stores:
        for path in store.record_paths():
            cells.setdefault((path.parent.name, path.stem), []).append(store)
    for cell, holders in cells.items():
        _joined(_read(cell, holders), joined_records)
    _check_answers(stores)
    for cell, holders in cells.items():
        _write_cell(target, cell, holders)
    _write_cache(target, stores)
    _write_answers(target, stores)
    target.save_run({**run, **_ordered(run, methods, metrics)})
    keep_summary(target)
    several = sum(len(holders) > 1 for holders in cells.values())
    return Merged(tuple(store.root for store in stores), len(cells), several)


def _joined(found: Sequence[tuple[Path, T]], join: Callable[[T, T], T]) -> T:
    """All of them in one; raises `BadInput` with both files for the first that contradicts those before it."""
    result = found[0][1]
    for i, (path, value) in enumerate(found[1:], start=1):
        try:
            result = join(result, value)
        except Conflict as error:
            other = next((p for p, earlier in found[:i] if _clash(join, earlier, value)), found[0][0])
            raise BadInput(
                f"{other} and {path} contradict each other: {error}",
                "parts of one run: the same code, data and options",
                "find out which is right, and delete the other or leave its run out",
            ) from error
    return result


def _clash(join: Callable[[T, T], T], a: T, b: T) -> bool:
    try:
        join(a, b)
    except Conflict:
        return True
    return False


def _run_of(store: RunStore) -> dict[str, Any]:
    run = store.load_run()
    if run is None:
        raise BadInput(f"no run in '{store.root}'", "a folder that holds run.json", "name the folder of a run")
    _check_seal(store.run_path, read_json(store.run_path))
    return joined_runs(run, run)  # the form that all of them have


def _read(cell: tuple[str, str], holders: Iterable[RunStore]) -> list[tuple[Path, CellRecord]]:
    return [_read_one(store.record_path(*cell)) for store in holders]


def _read_one(path: Path) -> tuple[Path, CellRecord]:
    document = read_json(path)
    _check_seal(path, document)
    record = CellRecord.from_json(document, str(path))
    if (record.method, record.scene) != (path.parent.name, path.stem):
        raise BadInput(
            f"{path} holds the result of {record.method} on {record.scene}",
            "the result that its name says",
            "see bench verify",
        )
    return path, record


def _check_seal(path: Path, document: dict[str, Any]) -> None:
    if is_sealed(document) and (parts := broken_seals(document)):
        raise BadInput(
            f"{path}: its {' and its '.join(parts)} is not what was written",
            "files as bench run wrote them",
            "delete it and run the scene again; bench verify finds all such files",
        )


def _write_cell(target: RunStore, cell: tuple[str, str], holders: Sequence[RunStore]) -> None:
    """The files that belong to a result, then the result."""
    found = _read(cell, holders)
    record = reduce(joined_records, (one for _, one in found))
    makers = [s for s, (_, one) in zip(holders, found) if canonical(own_timing(one)) == canonical(own_timing(record))]
    if (work := next((s.work_path(*cell) for s in makers if s.work_path(*cell).is_dir()), None)) is not None:
        _copy_folder(work, target.work_path(*cell))
    if record.failure is None:
        frames = [s.frames_path(*cell) for s, (_, one) in zip(holders, found) if one.failure is None]
        if there := [path for path in frames if path.is_file()]:
            _copy(_smallest(there), target.frames_path(*cell))
        for store in holders:
            if (cameras := store.load_trajectory(record.trajectory_sha256 or "")) is not None:
                target.save_trajectory(cameras)
                break
    files = [store.record_path(*cell) for store in holders]
    path = target.record_path(*cell)
    if len({file.read_bytes() for file in files}) == 1:
        _copy(files[0], path)
    elif not path.is_file() or json.dumps(read_json(path)) != json.dumps(record.to_json()):
        target.save(record)


def _smallest(paths: Sequence[Path]) -> Path:
    """One of several files that say the same, whatever their order."""
    return paths[0] if len(paths) == 1 else min(paths, key=file_sha256)


def _copy(source: Path, path: Path) -> None:
    if path.is_file() and (path.samefile(source) or filecmp.cmp(source, path, shallow=False)):
        return
    with atomic_path(path) as temporary:
        shutil.copyfile(source, temporary)


def _copy_folder(source: Path, path: Path) -> None:
    if path.is_dir() and path.samefile(source):
        return
    shutil.rmtree(path, ignore_errors=True)
    for file in sorted(p for p in source.rglob("*") if p.is_file()):
        _copy(file, path / file.relative_to(source))


def _write_cache(target: RunStore, stores: Sequence[RunStore]) -> None:
    """Scores by content: the same key is the same score; of two that are not, the one that is as it was written."""
    for store in stores:
        folder = store.root / "cache" / "scores"
        for path in sorted(folder.glob("*/[!.]*.json")):
            kept = target.root / path.relative_to(store.root)
            if not kept.is_file() or _rank(path) < _rank(kept):
                _copy(path, kept)


def _rank(path: Path) -> tuple[bool, bytes]:
    content = path.read_bytes()
    try:
        broken = bool(broken_seals(json.loads(content)))
    except (ValueError, AttributeError, RecursionError):
        broken = True
    return broken, content


def _answers(store: RunStore) -> Path:
    return store.root / "answers" / "llava.jsonl"


def _lines(path: Path) -> dict[str, str]:
    """Question -> answer, both as JSON; a line that a kill has torn is no answer."""
    found: dict[str, str] = {}
    for line in path.read_text(errors="replace").splitlines() if path.is_file() else ():
        try:
            entry = dict(json.loads(line))
            answer = entry.pop("answer")
        except (ValueError, TypeError, KeyError, RecursionError):
            continue
        found[json.dumps(entry, ensure_ascii=False)] = json.dumps(answer, ensure_ascii=False)
    return found


def _check_answers(stores: Sequence[RunStore]) -> dict[str, str]:
    """All answers of language models by question. Raises `BadInput` for two answers to one."""

    def both(a: dict[str, str], b: dict[str, str]) -> dict[str, str]:
        for question in a.keys() & b.keys():
            if a[question] != b[question]:
                raise Conflict(f"{question} answered {a[question]} and {b[question]}")
        return a | b

    return _joined([(_answers(store), _lines(_answers(store))) for store in stores], both)


def _write_answers(target: RunStore, stores: Sequence[RunStore]) -> None:
    together = _check_answers(stores)
    if together:
        lines = (
            json.dumps({**json.loads(question), "answer": json.loads(answer)}, ensure_ascii=False)
            for question, answer in sorted(together.items())
        )
        write_atomic(_answers(target), "".join(f"{line}\n" for line in lines).encode())


def _ordered(run: dict[str, Any], methods: Iterable[str], metrics: Iterable[str]) -> dict[str, list[str]]:
    """Scenes as the data set has them, if it is here, else by name; methods and metrics as they are registered."""
    identity, root = run["identity"], run.get("folders", {}).get("data_root")
    images = identity.get("images")
    try:
        dataset = open_dataset(
            str(identity["dataset"]),
            data_root=None if root is None else Path(root),
            images=None if images is None else Path(images),
            trajectory=identity.get("trajectory"),
        )
        scenes: Iterable[str] = dataset.scenes()
    except OrcaError:  # not on this machine
        scenes = ()
    known = {"scenes": scenes, "methods": methods, "metrics": metrics}
    return {key: in_order(run[key], names) for key, names in known.items()}
