"""No file gets its name but through `orca.atomic.atomic_path`: every place in the code that writes is looked at."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import bench
import orca

ROOT = Path(str(orca.__file__)).parents[1]
SOURCES = sorted(path for package in (orca, bench) for path in Path(str(package.__file__)).parent.rglob("*.py"))

METHODS = {"write_text", "write_bytes", "savefig", "tofile", "rename", "symlink_to", "hardlink_to", "touch"}
FUNCTIONS = {
    *(
        "os.replace",
        "os.rename",
        "os.link",
        "os.symlink",
        "shutil.move",
        "shutil.copy",
        "shutil.copyfile",
        "shutil.copy2",
    ),
    *("np.save", "np.savez", "np.savez_compressed", "np.savetxt", "torch.save", "save_file", "cv2.imwrite"),
    *("pq.write_table", "shutil.copytree", "urllib.request.urlretrieve"),
}
# Where a name is given, or bytes are added, in another way, and why nothing is lost there.
KNOWN = {
    ("orca/atomic.py", "_finish"): "the one place",
    ("bench/datasets/fetch.py", "fetch"): "a part is resumed, and takes its name after its hash was checked",
    ("bench/datasets/fetch.py", "_locked"): "the part",
    ("bench/metrics/llava_answers.py", "_append"): "one line a write; a torn line is asked again",
    ("bench/store.py", "alone"): "a lock, always empty",
    ("orca/video.py", "_encode"): "the path is the unfinished one of `write_video`",
    ("bench/cli.py", "_print"): "the null device",
    ("bench/memory.py", "_reset"): "a switch of the system",
}
SCRATCH = tuple(f"bench/stability/{name}.py" for name in ("ends", "files", "scenes", "worker"))  # all temporary
MEMORY = ("(buffer", "(file,", ", buffer,", ".save(out,")  # a stream in memory has no name


def writes(tree: ast.AST) -> Iterator[tuple[str, ast.Call]]:
    """(enclosing function, call) of everything that can write a file outside of ``with atomic_path(...)``."""

    def walk(node: ast.AST, function: str, safe: frozenset[str]) -> Iterator[tuple[str, ast.Call]]:
        if isinstance(node, ast.FunctionDef):
            function = node.name
        if isinstance(node, ast.With):
            for item in node.items:
                call = item.context_expr
                if isinstance(call, ast.Call) and ast.unparse(call.func) == "atomic_path":
                    safe |= {ast.unparse(item.optional_vars)} if item.optional_vars else set()
        if isinstance(node, ast.Call) and _writes(node) and not _names(node) & safe:
            yield function, node
        for child in ast.iter_child_nodes(node):
            yield from walk(child, function, safe)

    yield from walk(tree, "", frozenset())


def _names(node: ast.AST) -> set[str]:
    return {part.id for part in ast.walk(node) if isinstance(part, ast.Name)}


def _writes(call: ast.Call) -> bool:
    name = ast.unparse(call.func)
    last = name.rpartition(".")[2]
    if name in FUNCTIONS or last in METHODS or (last == "save" and "Image." in name):
        return True
    if name == "os.open":
        return any("O_CREAT" in ast.unparse(argument) or "O_W" in ast.unparse(argument) for argument in call.args)
    if last != "open":
        return False
    modes = [*call.args[(0 if name not in ("open", "io.open", "av.open") else 1) :], *(k.value for k in call.keywords)]
    return any(isinstance(m, ast.Constant) and isinstance(m.value, str) and _is_mode(m.value) for m in modes)


def _is_mode(text: str) -> bool:
    return len(text) <= 3 and set(text) <= set("wax+bt") and bool(set(text) & set("wax"))


def test_every_write_goes_through_the_one_function() -> None:
    found = {
        (path.relative_to(ROOT).as_posix(), function): ast.unparse(call)[:100]
        for path in SOURCES
        for function, call in writes(ast.parse(path.read_text(encoding="utf-8")))
    }
    unknown = {
        place: call
        for place, call in found.items()
        if place not in KNOWN and place[0] not in SCRATCH and not any(word in call for word in MEMORY)
    }
    assert unknown == {}
    assert set(KNOWN) <= set(found)


def test_the_search_finds_what_it_should() -> None:
    for text in (
        "def f():\n path.write_text('x')",
        "def f():\n open('a', 'w')",
        "def f():\n p.open('ab')",
        "def f():\n os.replace(a, b)",
        "def f():\n with atomic_path(p) as t:\n  other.write_bytes(b'')",
    ):
        assert [name for name, _ in writes(ast.parse(text))] == ["f"], text
    for text in (
        "def f():\n with atomic_path(p) as t, t.open('wb') as file:\n  file.write(b'')",
        "def f():\n with atomic_path(p) as t:\n  t.write_bytes(b'')",
        "def f():\n p.open()",
        "def f():\n zipfile.ZipFile(p).open('member')",
    ):
        assert list(writes(ast.parse(text))) == [], text
