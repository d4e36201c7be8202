"""A pickle reader that runs no code: what a file may name is a short list, and all of it is ours.

Unpickling calls whatever the file names. Here a name leads to one of the inert stand-ins below or to a refusal by name.
Arrays and tensors come out as numpy arrays that are checked against the bytes that are really there before anything is
allocated. The opcodes are read through once beforehand, since some of them reserve memory by a number in the file.
"""

from __future__ import annotations

import io
import pickle
import pickletools
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orca.errors import BadInput

__all__ = ["MAX_OPCODES", "Inert", "PickledArray", "RestrictedUnpickler", "checked_opcodes", "refused"]

# Half of what it takes to nest tuples so deep that hashing one overflows the C stack (between 100,000 and 300,000).
MAX_OPCODES = 50_000
_DTYPES = {"b1", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f2", "f4", "f8"}
_OPCODES = {
    *("PROTO", "FRAME", "STOP", "MARK", "NONE", "NEWTRUE", "NEWFALSE"),
    *("BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT", "MEMOIZE", "BINPUT", "LONG_BINPUT", "BINGET"),
    *("LONG_BINGET", "BINUNICODE", "SHORT_BINUNICODE", "BINBYTES", "SHORT_BINBYTES", "BINUNICODE8", "BINBYTES8"),
    *("EMPTY_TUPLE", "TUPLE", "TUPLE1", "TUPLE2", "TUPLE3", "EMPTY_LIST", "LIST", "APPEND", "APPENDS"),
    *("EMPTY_DICT", "DICT", "SETITEM", "SETITEMS", "GLOBAL", "STACK_GLOBAL", "REDUCE", "BUILD", "NEWOBJ"),
    "BINPERSID",
}


def refused(what: str) -> BadInput:
    """The error for anything that is not on the list."""
    return BadInput(
        f"a pickle that contains {what}",
        "tensors, numpy arrays, plain values and VistaDream's scene classes",
        "do not load this file with anything else either, unless you trust whoever wrote it",
    )


def checked_opcodes(pickled: bytes) -> None:
    """Read the opcodes through without running them.

    Raises:
        BadInput: an opcode that such files have no use for, too many of them (that bounds nesting, too), or a memo
            slot beyond their number: the reader would reserve that much.
    """
    count = 0
    try:
        for opcode, argument, _ in pickletools.genops(pickled):
            count += 1
            if opcode.name not in _OPCODES:
                raise refused(f"the opcode {opcode.name}")
            if count > MAX_OPCODES:
                raise refused(f"more than {MAX_OPCODES} opcodes")
            if opcode.name in ("BINPUT", "LONG_BINPUT") and (argument or 0) > count:
                raise refused(f"memo slot {argument}")
    except (ValueError, IndexError, EOFError, OverflowError, MemoryError) as error:
        if isinstance(error, BadInput):
            raise
        raise BadInput(f"a broken pickle ({error})", "a complete file", "copy the file again") from error


class Inert:
    """Stands for an object of a class that is not imported: keeps its fields, does nothing."""

    fields: Mapping[str, Any] = MappingProxyType({})  # of an object that was made but never given a state

    def __init__(self, *args: object) -> None:
        self.fields = {}

    def __setstate__(self, state: object) -> None:
        if not isinstance(state, dict) or not all(isinstance(key, str) for key in state):
            raise refused(f"an object whose state is a {type(state).__name__}")
        self.fields = dict(state)


class _Dtype:
    """Stands for ``numpy.dtype``."""

    dtype: np.dtype[Any] = np.dtype("u1")

    def __init__(self, code: object, align: object = False, copy: object = True) -> None:
        if code not in _DTYPES:
            raise refused(f"the array type {code!r:.40}")
        self.dtype = np.dtype(str(code))

    def __setstate__(self, state: object) -> None:
        if not (isinstance(state, tuple) and len(state) >= 2 and state[1] in ("<", ">", "|", "=")):
            raise refused("an array type with fields")
        self.dtype = self.dtype.newbyteorder(state[1])


class PickledArray:
    """Stands for ``numpy.ndarray``: `value` is the array once its state was read."""

    value: NDArray[Any] = np.empty(0)

    def __setstate__(self, state: object) -> None:
        if not (isinstance(state, tuple) and len(state) == 5):
            raise refused("an array of another format")
        _, shape, dtype, fortran, content = state
        if not (isinstance(dtype, _Dtype) and isinstance(content, bytes) and _is_shape(shape)):
            raise refused("an array of another format")
        size = _count(shape) * dtype.dtype.itemsize
        if size != len(content):
            raise refused(f"an array of shape {shape} with {len(content)} bytes")
        self.value = np.frombuffer(content, dtype.dtype).reshape(shape, order="F" if fortran else "C")


def _is_shape(shape: object) -> bool:
    return isinstance(shape, tuple) and len(shape) <= 8 and all(type(n) is int and 0 <= n < 2**40 for n in shape)


def _count(shape: tuple[int, ...]) -> int:
    total = 1
    for n in shape:
        total *= n
    return total


def _reconstruct(kind: object, shape: object, code: object) -> PickledArray:
    if kind is not PickledArray:
        raise refused("an array of another class")
    return PickledArray()


def _scalar(dtype: object, content: object) -> Any:
    if not (isinstance(dtype, _Dtype) and isinstance(content, bytes) and len(content) == dtype.dtype.itemsize):
        raise refused("a broken array scalar")
    return np.frombuffer(content, dtype.dtype)[0].item()


def _encode(text: object, encoding: object = "") -> bytes:
    """``_codecs.encode``, by which old protocols write bytes."""
    if not isinstance(text, str) or encoding != "latin1":
        raise refused("a codec other than latin1")
    try:
        return text.encode("latin1")
    except UnicodeEncodeError as error:
        raise refused("text where bytes belong") from error


def _no_bytes(*content: object) -> bytes:
    """``bytes()``, by which old protocols write none."""
    if content:
        raise refused("bytes made of something else")
    return b""


def _attribute(owner: object, name: object) -> Inert:
    """``getattr(torch._C._VariableFunctionsClass, "sigmoid")``: a function that a field holds."""
    if owner is not _TorchFunctions or not isinstance(name, str):
        raise refused("getattr")
    return Inert()


class _TorchFunctions:
    """Stands for torch's table of functions."""


_ALLOWED: dict[tuple[str, str], Callable[..., Any]] = {
    ("numpy", "ndarray"): PickledArray,
    ("numpy", "dtype"): _Dtype,
    ("_codecs", "encode"): _encode,
    ("collections", "OrderedDict"): dict,
    ("torch._C", "_VariableFunctionsClass"): _TorchFunctions,
    ("torch", "device"): Inert,
}
for _module in ("numpy.core.multiarray", "numpy._core.multiarray"):
    _ALLOWED |= {(_module, "_reconstruct"): _reconstruct, (_module, "scalar"): _scalar}
for _module in ("__builtin__", "builtins"):
    _ALLOWED |= {(_module, "getattr"): _attribute, (_module, "bytes"): _no_bytes}


class RestrictedUnpickler(pickle.Unpickler):
    """Reads one pickle with the stand-ins above and those that are passed in.

    Args:
        pickled: the pickle, which `checked_opcodes` has seen.
        allowed: (module, name) -> stand-in, beside the common ones.
        persistent: what a persistent id stands for; refused when left out.
    """

    def __init__(
        self,
        pickled: bytes,
        allowed: Mapping[tuple[str, str], Callable[..., Any]],
        persistent: Callable[[object], object] | None = None,
    ) -> None:
        super().__init__(io.BytesIO(pickled))
        self._allowed = {**_ALLOWED, **allowed}
        self._persistent = persistent

    def find_class(self, module: str, name: str) -> Any:
        """The stand-in for a name; raises `BadInput` for every name that has none."""
        if (module, name) not in self._allowed:
            raise refused(f"{module}.{name}"[:120])
        return self._allowed[module, name]

    def persistent_load(self, pid: object) -> object:
        """What stands for a persistent id."""
        if self._persistent is None:
            raise refused("a reference to something outside it")
        return self._persistent(pid)
