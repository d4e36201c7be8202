"""Reads what ``torch.save`` wrote, without torch and without running any of it."""

from __future__ import annotations

import pickle
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.adapters.restricted_pickle import RestrictedUnpickler, checked_opcodes, refused
from orca.errors import BadInput

__all__ = ["MAX_BYTES", "read_torch_file"]

MAX_BYTES = 8 * 2**30
MAX_PICKLE_BYTES = 2 * 2**30
MAX_MEMBERS = 20_000
_STORAGES = {
    **{"FloatStorage": "<f4", "DoubleStorage": "<f8", "HalfStorage": "<f2", "BFloat16Storage": "bf16"},
    **{"LongStorage": "<i8", "IntStorage": "<i4", "ShortStorage": "<i2", "CharStorage": "<i1"},
    **{"ByteStorage": "<u1", "BoolStorage": "|b1"},
}
# What `pickle` raises on nonsense, by its own documentation and by experience.
_BROKEN = (
    *(pickle.UnpicklingError, ValueError, TypeError, KeyError, IndexError, AttributeError, EOFError, ImportError),
    *(RuntimeError, MemoryError, OverflowError),
)
_ALLOWED_FILE = "a file of torch.save in its zip format (torch 1.6 or later)"


def read_torch_file(path: Path, allowed: Mapping[tuple[str, str], Callable[..., Any]]) -> Any:
    """The object of a file, with tensors as numpy arrays and classes as the stand-ins in ``allowed``.

    Args:
        path: the file.
        allowed: (module, name) -> stand-in for the classes that may occur.

    Raises:
        BadInput: not such a file, damaged, too large, or something in it that is not allowed (named in the error).
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise BadInput(f"{path}: {path.stat().st_size} bytes", f"at most {MAX_BYTES}", "use a smaller scene")
        with zipfile.ZipFile(path) as archive:
            return _Contents(archive, path).load(allowed)
    except BadInput as error:
        raise BadInput(f"{path}: {error.given}", error.allowed, error.fix) from error
    except (zipfile.BadZipFile, zipfile.LargeZipFile, OSError, NotImplementedError) as error:
        raise BadInput(f"{path} cannot be read ({error})", _ALLOWED_FILE, "copy the file again") from error
    except _BROKEN as error:
        raise BadInput(f"{path}: a broken pickle ({type(error).__name__})", _ALLOWED_FILE, "copy it again") from error


class _Contents:
    """The members of one archive, sizes checked."""

    def __init__(self, archive: zipfile.ZipFile, path: Path) -> None:
        self._archive = archive
        members = archive.infolist()
        pickles = [m.filename for m in members if m.filename.endswith("/data.pkl") and m.filename.count("/") == 1]
        if len(members) > MAX_MEMBERS or len(pickles) != 1:
            raise BadInput(f"an archive of {len(members)} files, {len(pickles)} data.pkl", _ALLOWED_FILE, "check it")
        self._prefix = pickles[0].removesuffix("data.pkl")
        self._members = {m.filename: m for m in members}
        if len(self._members) != len(members):
            raise refused("two files of one name")
        self._storages: dict[str, NDArray[np.uint8]] = {}

    def load(self, allowed: Mapping[tuple[str, str], Callable[..., Any]]) -> Any:
        order = f"{self._prefix}byteorder"
        if order in self._members and self._read(order, 16) != b"little":
            raise BadInput("a file of a big-endian machine", "little endian", "save it again on another machine")
        pickled = self._read(f"{self._prefix}data.pkl", MAX_PICKLE_BYTES)
        checked_opcodes(pickled)
        storages = {("torch", name): _storage_type(code) for name, code in _STORAGES.items()}
        tensors: dict[tuple[str, str], Callable[..., Any]] = {
            ("torch._utils", "_rebuild_tensor_v2"): _tensor,
            ("torch._utils", "_rebuild_parameter"): _parameter,
        }
        return RestrictedUnpickler(pickled, {**storages, **tensors, **allowed}, self._storage).load()

    def _read(self, name: str, limit: int) -> bytes:
        """A member, which torch never compresses: so no member can be larger than the file."""
        member = self._members.get(name)
        if member is None:
            raise BadInput(f"no {name} in the archive", _ALLOWED_FILE, "copy the file again")
        if member.compress_type != zipfile.ZIP_STORED or member.file_size != member.compress_size:
            raise refused("compressed data")
        if member.file_size > limit:
            raise refused(f"{name} of {member.file_size} bytes")
        content = self._archive.read(member)
        if len(content) != member.file_size:
            raise BadInput(f"{name} ends early", _ALLOWED_FILE, "copy the file again")
        return content

    def _storage(self, pid: object) -> NDArray[Any]:
        """("storage", type, key, device, number of elements) -> the elements, read-only."""
        if not (isinstance(pid, tuple) and len(pid) == 5 and pid[0] == "storage"):
            raise refused("a reference to something outside it")
        _, kind, key, _, numel = pid
        code = getattr(kind, "code", None)
        if not isinstance(code, str) or not isinstance(key, str) or type(numel) is not int or numel < 0:
            raise refused("a broken reference to a tensor's data")
        if key not in self._storages:
            content = self._read(f"{self._prefix}data/{key}", MAX_BYTES)
            self._storages[key] = np.frombuffer(content, np.uint8)
        raw = self._storages[key]
        width = 2 if code == "bf16" else np.dtype(code).itemsize
        if numel * width > len(raw):
            raise refused(f"a tensor of {numel} elements with {len(raw)} bytes")
        raw = raw[: numel * width]
        if code == "bf16":  # the upper half of a float32
            return np.asarray(raw.view("<u2").astype(np.uint32) << 16).view(np.float32)
        return raw.view(code)


def _storage_type(numpy_code: str) -> type[object]:
    return type("Storage", (), {"code": numpy_code})


def _tensor(storage: object, offset: object, size: object, stride: object, *rest: object) -> NDArray[Any]:
    """``torch._utils._rebuild_tensor_v2``: a view of a storage, copied; every element must lie inside it."""
    if not (isinstance(storage, np.ndarray) and isinstance(size, tuple) and isinstance(stride, tuple)):
        raise refused("a broken tensor")
    numbers: tuple[Any, ...] = (offset, *size, *stride)
    if len(size) != len(stride) or len(size) > 8 or not all(type(n) is int and 0 <= n < 2**40 for n in numbers):
        raise refused("a broken tensor")
    start = int(numbers[0])
    last = start + sum((n - 1) * step for n, step in zip(size, stride))
    count = 1
    for n in size:
        count *= n
    if count == 0:
        return np.empty(size, storage.dtype)
    # A stride of 0 would let a few bytes claim terabytes: no tensor is larger than what it is made of.
    if last >= len(storage) or count > len(storage):
        raise refused(f"a tensor of shape {size} on {len(storage)} elements")
    steps = [step * storage.itemsize for step in stride]
    return np.array(np.lib.stride_tricks.as_strided(storage[start:], size, steps, writeable=False))


def _parameter(values: object, requires_grad: object = False, hooks: object = None) -> NDArray[Any]:
    if not isinstance(values, np.ndarray):
        raise refused("a broken parameter")
    return values
