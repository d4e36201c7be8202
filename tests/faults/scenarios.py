"""Every fault that is injected; run by the tests, and written down, as it came out, by `tests.faults`."""

from __future__ import annotations

from collections.abc import Callable

from tests.faults import disks, killed
from tests.faults.interrupted import ctrl_c
from tests.faults.steps import eats, misbehaving, stuck
from tests.faults.workbench import Told, Workbench

__all__ = ["SCENARIOS", "VARIES"]

BOTH_ON_A, BOTH_ON_B = [["dark", "a"], ["light", "a"]], [["dark", "b"], ["light", "b"]]

# Injected -> what it does.
SCENARIOS: dict[str, Callable[[Workbench], Told]] = {
    "kill -9 at every write point of a run": killed.kills,
    "kill -9 at every write point of every other writer": killed.writers,
    "kill -9 of a worker (`--jobs 2`) at a result": killed.worker_killed,
    "ENOSPC at each kind of file": disks.refused("ENOSPC", "written"),
    "EROFS at each kind of file": disks.refused("EROFS", "start", "written"),
    "EACCES at each kind of file": disks.refused("EACCES", "start"),
    "a real disk of 64 kB that fills up": disks.full_disk,
    "a real disk that turns read-only": disks.read_only,
    "real folders that may not be written (chmod)": disks.no_right,
    "an image that vanishes between listing and loading": disks.vanished,
    "a metric that sleeps for ever (`--cell-timeout`)": misbehaving(
        "bright a", "hang", "timed_out", BOTH_ON_A, cell_timeout=8.0
    ),
    "a method that sleeps for ever (`--cell-timeout`)": misbehaving(
        "dark a", "hang", "timed_out", [["dark", "a"]], cell_timeout=8.0
    ),
    "a metric that never returns from compiled code": stuck,
    "a method that asks for 2^60 bytes": misbehaving("dark a", "memory", "out_of_memory", [["dark", "a"]]),
    "a metric that asks for 2^60 bytes": misbehaving("bright b", "memory", "out_of_memory", BOTH_ON_B),
    "a method that eats memory up to a limit (RLIMIT_AS)": eats(0),
    "the same in a worker (`--jobs 2`)": eats(2),
    "Ctrl-C": ctrl_c(1),
    "Ctrl-C, `--jobs 2`": ctrl_c(1, 2),
    "Ctrl-C twice": ctrl_c(2),
    "Ctrl-C twice, `--jobs 2`": ctrl_c(2, 2),
    "half of a result under its name": disks.torn_result,
    "half of the stored frames": disks.torn_frames,
    "half of each kept score": disks.torn_cache,
}
VARIES = ("a real disk of 64 kB that fills up", "Ctrl-C twice", "Ctrl-C twice, `--jobs 2`")
"""Those whose course depends on the machine and the moment; the others always end in the same words."""
