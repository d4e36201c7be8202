"""The licences of what this project depends on by name: ``python -m tests.licences`` writes docs/licences.md."""

from __future__ import annotations

import re
import tomllib
from importlib import metadata
from pathlib import Path

from bench.metrics.weights_fetch import SINGLE_FILES

__all__ = ["DOCS", "NOTES", "direct_dependencies", "licence_of", "rows", "weights"]

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs" / "licences.md"
# What a package's metadata do not say, or say too loosely, and what a user must know.
NOTES = {
    "pyiqa": "**non-commercial** (PolyForm Noncommercial 1.0.0 for pyiqa itself, NTU S-Lab 1.0 for parts)",
    "opencv-contrib-python-headless": "the wheel bundles FFmpeg (LGPL-2.1), named in its LICENSE-3RD-PARTY.txt",
    "av": "the wheel bundles FFmpeg (LGPL-3.0) with libx264 and libx265 (GPL-2.0)",
    "torch": "torch itself is BSD-3-Clause, the rest is what the wheel bundles; CUDA wheels add NVIDIA's terms",
    "plyfile": "used by tests only",
    "transformers": "models keep their own licences",
    "diffusers": "models keep their own licences",
}
_HEAD = """# Licences

ORCA and bench: MIT. What they depend on by name (`pyproject.toml`), from the packages' own metadata; made by
`python -m tests.licences`, and a test fails when a dependency is missing here. Nothing of these is copied into this
repository. Weights and data sets keep their owners' terms.

**pyiqa (MUSIQ, CLIP-IQA as scored here) is under a non-commercial licence**: leave out `musiq` and `clipiqa` for
commercial use; NIQE is computed by code of this project.

| package | needed for | licence | note |
|---|---|---|---|
"""
_TAIL = """
## Downloads

`bench download` fetches over https only, redirects included, with a bound on the size. Nothing that has no pinned hash
is fetched; it is named, with its address and the place where it belongs. A file that comes with another hash is not
kept. The hash of every weights file that a score was made with is part of that score, wherever the file came from.

| weights | from | SHA-256 |
|---|---|---|
{weights}

The publisher of the NIQE prior states no hash; the 16 digits that are checked come from one public record by a user of
it. The model of `llava` (15 GB) has no hash on record: it is put in place by hand. Images, videos and archives of data
sets are pinned in `bench/datasets/manifest.py`. The priors of `orca` (`orca/priors/hub.py`) come from the hub over
https, by its own client, at a pinned commit, as safetensors without code: what the hub serves under that commit is
taken on trust. **No commit of Depth Pro could be verified**, so it is not downloaded unless
`ORCA_REVISION_DEPTHPRO_HF` names a commit (or `main`, a branch, which moves; that is then said). What lies in the
hub's cache or in `--weights-dir` is used.

## Known vulnerabilities

`pip freeze --exclude-editable > installed.txt && pip-audit --no-deps --disable-pip -r installed.txt` compares what is
installed with the advisories of PyPI. **It has not been done.** Tried on 22 November 2026, the reachable index had no
advisories and pip-audit 2.10.1 skipped all 160 packages (it then prints "No known vulnerabilities found", which is no
result). Tried again on 28 November 2026: it skips pillow 8.0.0 and urllib3 1.24 as well, which are known to be
vulnerable, and `-s osv` cannot resolve api.osv.dev. Run it where pypi.org itself can be reached, before a release.

What could be done there, in an environment of its own, is the same against an **old** list (22 November 2026):

    pip install "safety==1.10.3" safety-db "setuptools<80"
    safety check --db <site-packages>/safety_db -r installed.txt --full-report

safety-db 2021.7.17, data of 1 July 2021: 160 packages checked, none of them listed in the version that is installed
(17 of the 160 are in the list at all; the same command finds pillow 8.0.0 and urllib3 1.24). It says nothing about what
became known in the five years since, which is most of what there is to know.
"""


def direct_dependencies() -> dict[str, str]:
    """Package -> what it is needed for: "core", or the extra that brings it."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    groups = {"core": project["dependencies"], **project["optional-dependencies"]}
    found: dict[str, str] = {}
    for group, requirements in groups.items():
        for requirement in requirements:
            name = re.split(r"[\[<>=!~; ]", requirement, maxsplit=1)[0]
            if name != project["name"]:
                found.setdefault(name, group)
    return found


def licence_of(package: str) -> str:
    """The licence that the installed package states, in one line; "not installed here" for one that is not."""
    try:
        facts = metadata.metadata(package)
    except metadata.PackageNotFoundError:
        return "not installed here"
    trove = [c.split(" :: ")[-1] for c in facts.get_all("Classifier") or [] if c.startswith("License :: ")]
    expression = (facts.get("License-Expression") or "").strip()
    words = (facts.get("License") or "").strip()
    if expression:
        return expression if len(expression) <= 90 else f"{expression[:90].rpartition(' AND ')[0]} AND others"
    if words and len(words) <= 60 and "\n" not in words:
        return words
    named = ", ".join(word for word in trove if word != "OSI Approved")
    return named or (words.splitlines()[0][:60] if words else _licence_file(package))


def _licence_file(package: str) -> str:
    """The first lines of the licence that lies in the package, of one whose metadata say nothing."""
    for file in metadata.files(package) or ():
        if file.name.startswith("LICENSE") and ".dist-info" in str(file):
            lines = [line.strip() for line in file.read_text(encoding="utf-8").splitlines() if line.strip()]
            return ", ".join(lines[:2])[:60]
    return "not stated"


def rows() -> list[str]:
    """The table's rows."""
    return [
        f"| {name} | {group} | {licence_of(name)} | {NOTES.get(name, '')} |"
        for name, group in direct_dependencies().items()
    ]


def weights() -> list[str]:
    """The rows of what `bench download weights` fetches."""
    return [f"| `{file.name}` | {file.source} | `{file.expected_sha256}` |" for file in SINGLE_FILES]


def main() -> None:
    """Write the file."""
    DOCS.parent.mkdir(exist_ok=True)
    tail = _TAIL.format(weights="\n".join(weights()))
    DOCS.write_text(_HEAD + "\n".join(rows()) + "\n" + tail, encoding="utf-8")


if __name__ == "__main__":
    main()
