"""Two processes, other hash seeds, the images laid down in another order: the same files apart from timing and host."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orca.images import save_image

REPO = Path(__file__).parents[2]
NAMES = ("zebra", "apple", "mango")
# The first process lists a directory as the system does, the second one backwards and with another hash seed.
BACKWARDS = """
import os, pathlib, sys
scan, listed, walked = os.scandir, os.listdir, os.walk
if sys.argv[1] == "backwards":
    os.listdir = lambda *a: list(reversed(listed(*a)))
    class Scan:
        def __init__(self, *a):
            with scan(*a) as it: self.found = iter(list(it)[::-1])
        def __iter__(self): return self.found
        def __next__(self): return next(self.found)
        def __enter__(self): return self
        def __exit__(self, *a): pass
        def close(self): pass
    os.scandir = Scan
from bench.cli import main
sys.exit(main(sys.argv[2:]))
"""


def make_images(folder: Path, order: tuple[str, ...]) -> None:
    for name in order:
        rng = np.random.default_rng(len(name) * ord(name[0]))
        low = rng.integers(40, 220, (6, 8, 3)).astype(np.uint8)
        save_image(folder / f"{name}.png", np.kron(low, np.ones((8, 8, 1), np.uint8)))


def run(folder: Path, order: tuple[str, ...], how: str, hash_seed: str, *arguments: str) -> dict[str, Any]:
    """Run the bench in a process of its own with ``folder`` as its working directory; return its JSON files."""
    make_images(folder / "images", order)
    env = {**os.environ, "PYTHONHASHSEED": hash_seed, "PYTHONPATH": str(REPO), "OMP_NUM_THREADS": "1"}
    env |= {"NUMBA_NUM_THREADS": "1", "XDG_CACHE_HOME": str(folder / "none")}
    env.pop("ORCA_DATA_ROOT", None)
    argv = ["run", "--dataset", "folder", "--images", "images", "--out", "out", "--data-root", "images", *arguments]
    done = subprocess.run(
        [sys.executable, "-c", BACKWARDS, how, *argv], cwd=folder, env=env, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return {
        p.relative_to(folder).as_posix(): json.loads(p.read_text()) for p in sorted((folder / "out").rglob("*.json"))
    }


def lasting(document: Any, images: Path) -> Any:
    """Without the timing and the host blocks; where the run lay, and which commit ran, is no result either."""
    plain = {key: value for key, value in document.items() if key not in ("timing", "host")}
    if "identity" in plain:
        assert plain["identity"]["images"] == str(images)
        plain["identity"] = {**plain["identity"], "images": "images"}
        plain.pop("digest")  # over the folder's name
        plain.pop("code")  # another commit may come between the two
    return plain


@pytest.mark.slow
def test_two_processes_write_the_same_files(tmp_path: Path) -> None:
    arguments = ("--methods", "orca,warp-telea", "--metrics", "tsed,input_psnr,hole_fraction", "--codec-match")
    one = run(tmp_path / "one", NAMES, "as it comes", "1", *arguments, "--scenes", "mango,apple")
    two = run(tmp_path / "two", NAMES[::-1], "backwards", "4242", *arguments, "--scenes", "mango,apple")
    assert one.keys() == two.keys()
    results = [name for name in one if name.startswith(("out/scenes", "out/trajectories", "out/run.json"))]
    assert len(results) == 6
    for name in results:
        mine, other = lasting(one[name], tmp_path / "one/images"), lasting(two[name], tmp_path / "two/images")
        assert json.dumps(mine) == json.dumps(other), name  # the order of the keys too
    binary = [path for path in sorted((tmp_path / "one/out").rglob("*")) if path.suffix in (".npz", ".parquet")]
    assert len(binary) == 5
    for path in binary:
        assert path.read_bytes() == (tmp_path / "two" / path.relative_to(tmp_path / "one")).read_bytes(), path.name
