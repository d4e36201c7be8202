"""A missing browser or LaTeX is a skip at home and a failure in CI; `.ci/run` tells the tests which it is."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from tests import browser
from tests.programs import REQUIRED, need_programs

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.parametrize(("value", "outcome"), [("", pytest.skip.Exception), ("0", pytest.skip.Exception)])
def test_what_is_missing_is_skipped(value: str, outcome: type[Exception], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(REQUIRED, value)
    with pytest.raises(outcome, match="no such-a-program on the path"):
        need_programs("such-a-program", "sh")
    need_programs("sh")


def test_what_is_missing_fails_where_it_is_required(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(REQUIRED, "1")
    with pytest.raises(pytest.fail.Exception, match="such-a-program"):
        need_programs("such-a-program")
    monkeypatch.setattr(browser, "_NAMES", ("such-a-browser",))
    with pytest.raises(pytest.fail.Exception, match="no chromium"), browser.open_page():
        pass


def ci_run(folder: Path, apt: str, others: tuple[str, ...]) -> subprocess.CompletedProcess[str]:
    """`.ci/run` with a path of stand-ins: make tells what it was given, apt-get does as told, root is asking."""
    stand_ins = {"make": f'echo "make $1 required=${{{REQUIRED}:-unset}}"', "id": "echo 0", "apt-get": apt}
    stand_ins |= dict.fromkeys(others, "exit 0")
    for name, line in stand_ins.items():
        (folder / name).write_text(f"#!/bin/sh\n{line}\n")
        (folder / name).chmod(0o755)
    for name in ("bash", "sh", "dirname", "timeout", "env", "cat", "tail", "mktemp", "rm"):
        (folder / name).symlink_to(f"/usr/bin/{name}")
    environment = {"PATH": str(folder), "HOME": str(folder), "ORCA_DATA_ROOT": str(folder)}
    assert REQUIRED not in environment
    command = [str(folder / "bash"), str(ROOT / ".ci" / "run")]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=60)


PROGRAMS = ("chromium", "pdflatex", "pdftohtml")
needs_bin = pytest.mark.skipif(not os.path.exists("/usr/bin/bash"), reason="no /usr/bin/bash to link to")


@needs_bin
def test_ci_requires_them_where_they_are(tmp_path: Path) -> None:
    done = ci_run(tmp_path, "exit 9", PROGRAMS)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-2:] == ["make lint required=1", "make test required=1"]


@needs_bin
def test_ci_installs_what_is_missing(tmp_path: Path) -> None:
    """The stand-in for apt-get writes the programs that real packages would bring."""
    program = f'for p in {" ".join(PROGRAMS)}; do echo "#!/bin/sh" > {tmp_path}/$p; /bin/chmod +x {tmp_path}/$p; done'
    done = ci_run(tmp_path, f'[ "$1" = update ] && exit 0\necho "apt-get $*" > {tmp_path}/asked\n{program}', ())
    assert done.returncode == 0, done.stderr
    asked = (tmp_path / "asked").read_text()
    assert {"install", "--no-install-recommends", "chromium", "poppler-utils"} <= set(asked.split())
    assert done.stdout.splitlines()[-1] == "make test required=1"


@needs_bin
def test_a_failure_of_apt_is_printed_and_fails_nothing(tmp_path: Path) -> None:
    done = ci_run(tmp_path, "echo E: no such place >&2\nexit 100", ())
    assert done.returncode == 0, done.stderr
    assert "E: no such place" in done.stdout + done.stderr
    assert "tests of pages and of LaTeX are skipped" in done.stdout + done.stderr
    assert done.stdout.splitlines()[-1] == "make test required=unset"
