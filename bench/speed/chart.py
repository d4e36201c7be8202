"""The chart of closed-form against random initialisation, and its figures as CSV."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

from bench.speed.initialisation import INITIALISATIONS, Curve
from orca.atomic import atomic_path

__all__ = ["write_chart", "write_csv"]

_LOOK = {"closed_form": ("#0072b2", "o", "closed form, then gradient"), "random": ("#d55e00", "s", "random, gradient")}


def write_csv(curves: Sequence[Curve], path: Path) -> None:
    """One line a point."""
    with atomic_path(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        head = ["scene", "initialisation", "anchors", "cpu_s", "wall_s", "solver_steps", "iterations", "psnr_db"]
        writer.writerow(head)
        for curve in curves:
            for p in curve.points:
                times = [f"{p.cpu_s:.3f}", f"{p.wall_s:.3f}"]
                what = [p.solver_steps, p.iterations, f"{p.psnr:.3f}"]
                writer.writerow([curve.scene, curve.initialisation, curve.anchors, *times, *what])


def write_chart(curves: Sequence[Curve], path: Path) -> None:
    """PSNR of the input view over CPU seconds, a panel a scene, the time axis logarithmic."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    scenes = list(dict.fromkeys(curve.scene for curve in curves))
    figure, axes = plt.subplots(1, len(scenes), figsize=(4.2 * len(scenes), 3.6), squeeze=False)
    for scene, axis in zip(scenes, axes[0], strict=True):
        for name in INITIALISATIONS:
            points = [p for c in curves if c.scene == scene and c.initialisation == name for p in c.points]
            colour, marker, label = _LOOK[name]
            axis.plot([p.cpu_s for p in points], [p.psnr for p in points], color=colour, marker=marker, label=label)
        axis.set(title=scene, xlabel="CPU time of the planar fit [s]", xscale="log")
        axis.grid(alpha=0.3)
    axes[0][0].set_ylabel("PSNR of the input view [dB]")
    axes[0][0].legend(loc="best", fontsize=8)
    figure.tight_layout()
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=110)
    plt.close(figure)
