"""VistaDream's scene.pth is a pickle: nothing in it may run, and nothing in it may ask for more memory than it has."""

from __future__ import annotations

import contextlib
import io
import os
import pickle
import pickletools
import subprocess
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bench.adapters.restricted_pickle import MAX_OPCODES, RestrictedUnpickler, checked_opcodes
from bench.adapters.torch_file import read_torch_file
from bench.adapters.vistadream_scene import read_vistadream_scene
from orca.errors import BadInput, OrcaError
from tests.bench.splat_files import cloud_of, save_vistadream_scene


class Calls:
    """Pickles as a call of any function."""

    def __init__(self, function: Callable[..., object], *args: object) -> None:
        self.call = function, args

    def __reduce__(self) -> tuple[Callable[..., object], tuple[object, ...]]:
        return self.call


def saved(tmp_path: Path, thing: object) -> Path:
    path = tmp_path / "scene.pth"
    torch.save(thing, path)
    return path


@pytest.mark.parametrize("protocol", [2, 4])
@pytest.mark.parametrize(
    ("function", "args"),
    [
        (os.system, ("touch HIT",)),
        (subprocess.check_output, (["touch", "HIT"],)),
        (eval, ("open('HIT', 'w')",)),
        (open, ("HIT", "w")),
        (getattr, ("", "format")),
        (pickle.loads, (b"\x80\x02N.",)),
        (np.load, ("x.npy",)),
        (torch.load, ("x.pth",)),
        (__import__, ("os",)),
    ],
)
def test_a_call_is_refused_by_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, protocol: int, function: Callable[..., object], args: tuple[object]
) -> None:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "scene.pth"
    torch.save({"x": Calls(function, *args)}, path, pickle_protocol=protocol)
    with pytest.raises(BadInput, match="a pickle that contains"):
        read_vistadream_scene(path)
    assert not (tmp_path / "HIT").exists()


def test_an_attribute_of_something_else_is_refused() -> None:
    """getattr is allowed on the stand-in for torch's functions and on nothing else."""
    through = b"\x80\x02c__builtin__\ngetattr\nc__builtin__\ngetattr\nX\x08\x00\x00\x00__self__\x86R."
    checked_opcodes(through)
    with pytest.raises(BadInput, match="getattr"):
        RestrictedUnpickler(through, {}).load()
    nested = b"\x80\x04\x8c\x05numpy\x8c\x10ndarray.__init__\x93."
    with pytest.raises(BadInput, match=r"numpy\.ndarray\.__init__"):
        RestrictedUnpickler(nested, {}).load()


@pytest.mark.parametrize(
    ("pickled", "said"),
    [
        (b"\x80\x02r\xff\xff\xff\x7f.", None),
        (b"\x80\x02Nr\xff\xff\xff\x7f.", "memo slot 2147483647"),
        (b"\x80\x05\x96\x00\x00\x00\x00\x00\x10\x00\x00.", None),
        (b"\x80\x05\x97.", "NEXT_BUFFER"),
        (b"\x80\x02\x82\x01.", "EXT1"),
        (b"(i os\nsystem\n.", "INST"),
        (b"\x80\x02" + b"N" * (MAX_OPCODES + 5) + b".", "more than"),
        (b"", None),
        (b"\x80\x02X\xff\xff\xff\x7fabc.", None),
        (b"\x80\x04\x8d\xff\xff\xff\xff\xff\xff\xff\x0fabc.", None),
    ],
)
def test_opcodes_that_reserve_memory_or_reach_out(pickled: bytes, said: str | None) -> None:
    with pytest.raises(BadInput, match=said):
        checked_opcodes(pickled)


def array_with(shape: tuple[int, ...], code: str, content: bytes) -> bytes:
    """A pickled array whose state claims another shape or type than its bytes have."""

    class Claim:
        def __reduce__(self) -> tuple[object, ...]:
            call, args, _ = np.zeros(1).__reduce__()
            return call, args, (1, shape, np.dtype(code), False, content)

    return pickle.dumps(Claim(), 2)


def test_arrays_are_checked_against_their_bytes() -> None:
    good = array_with((2, 2), "f8", np.arange(4.0).tobytes())
    np.testing.assert_array_equal(RestrictedUnpickler(good, {}).load().value, [[0, 1], [2, 3]])
    for shape, content, said in (
        ((2**39, 2**39), b"\0" * 8, "with 8 bytes"),
        ((-1,), b"", "another format"),
        ((2,), b"\0" * 8, "with 8 bytes"),
        ((1,) * 33, b"\0" * 8, "another format"),
    ):
        with pytest.raises(BadInput, match=said):
            RestrictedUnpickler(array_with(shape, "f8", content), {}).load()
    with pytest.raises(BadInput, match="array type"):
        RestrictedUnpickler(pickle.dumps(np.array([None, 1], object), 2), {}).load()
    with pytest.raises(BadInput, match="array type"):
        RestrictedUnpickler(pickle.dumps(np.zeros(2, [("a", "f4")]), 2), {}).load()
    big_endian = pickle.dumps(np.arange(3, dtype=">f4"), 2)
    np.testing.assert_array_equal(RestrictedUnpickler(big_endian, {}).load().value, [0, 1, 2])
    fortran = pickle.dumps(np.asfortranarray(np.arange(6.0).reshape(2, 3)), 2)
    np.testing.assert_array_equal(RestrictedUnpickler(fortran, {}).load().value, [[0, 1, 2], [3, 4, 5]])


@pytest.mark.parametrize(
    "tensor",
    [
        torch.arange(6.0).reshape(2, 3).t(),
        torch.arange(10, dtype=torch.int64)[3:7],
        torch.tensor([1.5, -2.25], dtype=torch.bfloat16),
        torch.tensor([1.5, -2.25], dtype=torch.float16),
        torch.tensor(3.0),
        torch.zeros(0, 3),
        torch.tensor([True, False]),
    ],
)
def test_tensors_equal_torchs_own_reading(tmp_path: Path, tensor: torch.Tensor) -> None:
    read = read_torch_file(saved(tmp_path, [tensor, torch.nn.Parameter(tensor, requires_grad=False)]), {})
    for array in read:
        np.testing.assert_array_equal(array, tensor.float().numpy() if tensor.dtype == torch.bfloat16 else tensor)
        assert array.shape == tuple(tensor.shape)


def rewritten(path: Path, change: Callable[[str, bytes], bytes | None], compress: int = zipfile.ZIP_STORED) -> Path:
    """The same archive with some members changed or left out."""
    with zipfile.ZipFile(path) as old:
        members = {name: old.read(name) for name in old.namelist()}
    with zipfile.ZipFile(path, "w", compress) as new:
        for name, content in members.items():
            changed = change(name, content)
            if changed is not None:
                new.writestr(name, changed)
    return path


def test_claims_of_tensors_are_checked(tmp_path: Path) -> None:
    def claim(**changes: object) -> Callable[[str, bytes], bytes]:
        def change(name: str, content: bytes) -> bytes:
            for old, new in changes["swap"] if name.endswith("data.pkl") else ():  # type: ignore[attr-defined]
                assert old in content
                content = content.replace(old, new, 1)
            return content

        return change

    size, numel = b"K\x07K\x03\x86", b"K\x15"  # (7, 3) and 21 elements
    for old, new, said in (
        (size, b"J\xff\xff\xff\x7fK\x03\x86", "a tensor of shape"),
        (size, b"J\xff\xff\xff\xffK\x03\x86", "a broken tensor"),
        (b"K\x03K\x01\x86", b"K\x00K\x00\x86", None),  # strides of 0: 21 elements of one are no larger than the file
        (b"cpuq", b"cpuq", None),
    ):
        path = saved(tmp_path, [torch.arange(21.0).reshape(7, 3)])
        rewritten(path, claim(swap=[(old, new)]))
        if said is None:
            assert read_torch_file(path, {})[0].shape == (7, 3)
        else:
            with pytest.raises(BadInput, match=said):
                read_torch_file(path, {})
    path = rewritten(saved(tmp_path, [torch.arange(21.0).reshape(7, 3)]), claim(swap=[(numel, b"K\x16")]))
    with pytest.raises(BadInput, match="22 elements with 84 bytes"):
        read_torch_file(path, {})


def test_archives_that_are_none(tmp_path: Path) -> None:
    thing = [torch.arange(4.0)]
    path = saved(tmp_path, thing)
    whole = path.read_bytes()
    with pytest.raises(BadInput, match="compressed data"):
        read_torch_file(rewritten(path, lambda _, content: content + b" " * 64, zipfile.ZIP_DEFLATED), {})
    for leave_out in ("data.pkl", "data/0"):
        path.write_bytes(whole)
        rewritten(path, lambda name, content, gone=leave_out: None if name.endswith(gone) else content)
        with pytest.raises(BadInput, match=leave_out.rsplit("/", 1)[0]):
            read_torch_file(path, {})
    path.write_bytes(whole)
    rewritten(path, lambda name, content: b"big" if name.endswith("byteorder") else content)
    with pytest.raises(BadInput, match="big-endian"):
        read_torch_file(path, {})
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(BadInput, match="cannot be read"):
        read_torch_file(path, {})
    torch.save(thing, path, _use_new_zipfile_serialization=False)
    with pytest.raises(BadInput, match="zip format"):
        read_torch_file(path, {})
    with pytest.raises(BadInput, match="cannot be read"):
        read_torch_file(tmp_path / "none.pth", {})


def test_things_that_are_no_scene(tmp_path: Path) -> None:
    for thing, said in (({"a": 1}, "holds a dict"), (torch.zeros(3), "holds a ndarray"), (None, "holds a NoneType")):
        with pytest.raises(BadInput, match=said):
            read_vistadream_scene(saved(tmp_path, thing))
    path = tmp_path / "scene.pth"
    for field, said in (("gaussian_frames", "without gaussian_frames"), ("rotation", "has no rotation")):
        save_vistadream_scene(path, cloud_of(4))
        other = field[:-1] + "#"

        def renamed(name: str, content: bytes, old: str = field, new: str = other) -> bytes:
            return content.replace(old.encode(), new.encode()) if name.endswith("data.pkl") else content

        rewritten(path, renamed)
        with pytest.raises(BadInput, match=said):
            read_vistadream_scene(path)


def test_a_class_of_another_module_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "scene.pth"
    save_vistadream_scene(path, cloud_of(4))

    def moved(name: str, content: bytes) -> bytes:
        return content.replace(b"ops.gs.basic", b"ops.gs.other") if name.endswith("data.pkl") else content

    rewritten(path, moved)
    with pytest.raises(BadInput, match=r"ops\.gs\.other\.Gaussian_Scene"):
        read_vistadream_scene(path)


def test_a_scene_of_twenty_frames_is_far_below_the_limit_of_opcodes(tmp_path: Path) -> None:
    path = tmp_path / "scene.pth"
    save_vistadream_scene(path, cloud_of(40), frames=20)
    with zipfile.ZipFile(path) as archive:
        pickled = next(archive.read(name) for name in archive.namelist() if name.endswith("data.pkl"))
    assert sum(1 for _ in pickletools.genops(pickled)) < MAX_OPCODES / 5


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(changes=st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), min_size=1, max_size=6))
def test_a_damaged_scene_is_read_or_refused(tmp_path: Path, changes: list[tuple[int, int]]) -> None:
    """Bytes changed anywhere in the pickle: a scene or an `OrcaError`, never anything else."""
    source = tmp_path / "whole.pth"
    if not source.exists():
        save_vistadream_scene(source, cloud_of(4), frames=1)
    damaged = io.BytesIO()
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(damaged, "w") as new:
        for name in old.namelist():
            content = bytearray(old.read(name))
            if name.endswith("data.pkl"):
                for place, value in changes:
                    content[place % len(content)] = value
            new.writestr(name, bytes(content))
    path = tmp_path / "damaged.pth"
    path.write_bytes(damaged.getvalue())
    with contextlib.suppress(OrcaError):
        read_vistadream_scene(path)
