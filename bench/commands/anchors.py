"""``bench anchors``: how many anchors a scene needs, as a chart, its figures and a page."""

from __future__ import annotations

import argparse
import csv
from collections.abc import Sequence
from pathlib import Path

from bench.anchorcurve import CurvePoint, Goal, SceneCurve, measure_curve, needed
from bench.commands.names import chosen
from bench.commands.outcome import Outcome
from bench.datasets.catalogue import open_dataset
from orca.atomic import atomic_path
from orca.config import GrowthConfig, get_preset
from orca.errors import BadInput

__all__ = ["anchors_command"]

_COLUMNS = ["scene", "target_db", "price_db", "placement", "anchors", "psnr_db", "fit_cpu_s", "frame_cpu_ms", "why"]
_TICKS = range(14, 19)  # of the chart: 16k to 262k anchors
_DIGITS = {"psnr_db": ".3f", "fit_cpu_s": ".2f", "frame_cpu_ms": ".0f"}


def anchors_command(args: argparse.Namespace) -> Outcome:
    """Measure every scene; what is measured is written at once, and not measured again for the same target
    and price.

    Raises:
        Unknown: no such data set or scene.
        BadInput: a target or a price that is not positive, or a folder with another kind of anchors.csv.
    """
    GrowthConfig(target_psnr=args.target_psnr, price=args.price)  # refuses what makes no sense
    goal = Goal(psnr_db=args.target_psnr, price=args.price)
    dataset = open_dataset(args.dataset, data_root=args.data_root, images=args.images)
    known = tuple(dataset.scenes())
    curves = {} if args.out is None else _read(args.out / "anchors.csv", goal)
    names = chosen("scene", args.scenes, known, known)
    for name in names:
        if name not in curves:
            curves[name] = measure_curve(dataset.load(name), get_preset("draft"), goal)
            if args.out is not None:
                _write_rows(args.out / "anchors.csv", [curves[key] for key in sorted(curves)])
    shown = [curves[key] for key in sorted(curves)]
    if args.out is not None:
        with atomic_path(args.out / "README.md") as path:
            path.write_text("\n".join(_page(shown, goal)) + "\n", encoding="utf-8")
        _draw(args.out / "anchors.png", shown, goal)
    document = {"schema_version": 1, "scenes": [curve.to_json() for curve in shown]}
    return Outcome("\n".join(_page(shown, goal)), document)


def _read(path: Path, goal: Goal) -> dict[str, SceneCurve]:
    """What a file holds of this goal, by scene."""
    if not path.is_file():
        return {}
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    if rows and set(rows[0]) != set(_COLUMNS):
        raise BadInput(f"{path} with columns {', '.join(rows[0])}", ", ".join(_COLUMNS), "choose another folder")
    by_scene: dict[str, list[dict[str, str]]] = {}
    for row in rows:
        if (float(row["target_db"]), float(row["price_db"])) == (goal.psnr_db, goal.price):
            by_scene.setdefault(row["scene"], []).append(row)
    return {name: SceneCurve.of_rows(some) for name, some in by_scene.items()}


def _write_rows(path: Path, curves: Sequence[SceneCurve]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, _COLUMNS, lineterminator="\n")
        writer.writeheader()
        for row in (row for curve in curves for row in curve.rows()):
            rounded = {k: format(row[k], digits) for k, digits in _DIGITS.items()}
            writer.writerow({**row, **rounded})


def _page(curves: Sequence[SceneCurve], goal: Goal) -> list[str]:
    """A Markdown page: anchors at equal count, count at equal quality, and the knee."""
    aim = goal.psnr_db
    lines = [
        "### Quality against anchors",
        "",
        "The input image alone, on the plane. 65k grown: content-driven start, grown by residual to 65,536.",
        f"Share: anchors that growing needs for {aim:g} dB, over those of the grid with one per pixel.",
        f"Knee: where `--target-psnr {aim:g} --price {goal.price:g}` stops: at that quality, or when a thousand more",
        f"anchors gain less than {goal.price:g} dB. Fit and frame: CPU time of growing to {aim:g} dB and a frame then,",
        "against the grid with one anchor per pixel; medians of 3, taken in turns in one process.",
        "",
        "| scene | 65k grid [dB] | 65k grown [dB] | 131k grid [dB] | gain [dB] | share | knee | fit [s] | frame [ms] |",
        "|---|---:|---:|---:|---:|---:|---|---:|---:|",
    ]
    gains = []
    for curve in curves:
        quarter, half, full = (curve.grid(share) for share in (0.25, 0.5, 1.0))
        grown, last, knee = curve.grown_at(0.25), curve.reached, curve.knee
        gains.append(grown.psnr_db - quarter.psnr_db)
        need = needed(curve, goal.psnr_db)
        seconds, frame = f"{last.fit_cpu_s:.2f} of {full.fit_cpu_s:.2f}", f"{last.frame_cpu_ms:.0f}"
        share = f"> {last.anchors / full.anchors:.0%}" if need is None else f"{need / full.anchors:.0%}"
        lines.append(
            f"| {curve.scene} | {quarter.psnr_db:.2f} | {grown.psnr_db:.2f} | {half.psnr_db:.2f} | {gains[-1]:+.2f} "
            f"| {share} | {knee.anchors:,} at {knee.psnr_db:.1f} dB ({_which(knee)}) "
            f"| {seconds} | {frame} of {full.frame_cpu_ms:.0f} |"
        )
    above = sum(c.grown_at(0.25).psnr_db > c.grid(0.5).psnr_db for c in curves)
    lines += [
        "",
        f"Mean gain at equal count {sum(gains) / len(gains):+.2f} dB; above the 131k grid on {above} of {len(curves)}.",
    ]
    return lines


def _which(knee: CurvePoint) -> str:
    """Which limit stopped it, in a word or in its own words."""
    for word, beginning in (("target", "reached"), ("price", "a thousand anchors gained")):
        if knee.why.startswith(beginning):
            return word
    return knee.why


def _draw(path: Path, curves: Sequence[SceneCurve], goal: Goal) -> None:
    """A panel a scene: grown and grid over a logarithmic count, and the knee."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    across = min(4, len(curves))
    down = -(-len(curves) // across)
    figure, axes = plt.subplots(down, across, figsize=(2.9 * across, 2.4 * down), squeeze=False, sharex=True)
    for axis in axes.flat[len(curves) :]:
        axis.set_visible(False)
    for curve, axis in zip(curves, axes.flat, strict=False):
        grids = [p for p in curve.points if p.placement == "grid" and p.psnr_db < goal.psnr_db + 15]
        axis.plot([p.anchors for p in curve.grown], [p.psnr_db for p in curve.grown], "o-", ms=3, label="grown")
        axis.plot([p.anchors for p in grids], [p.psnr_db for p in grids], "s--", ms=3, label="regular grid")
        knee = curve.knee
        axis.plot(knee.anchors, knee.psnr_db, "r*", ms=10, label="knee")
        axis.axhline(goal.psnr_db, color="grey", lw=0.5)
        axis.set(title=f"{curve.scene}: {knee.anchors / 1000:.0f}k ({_which(knee)})", xscale="log", xlabel="anchors")
        axis.set_ylabel("PSNR [dB]")
        axis.set_xticks([2**k for k in _TICKS], [f"{2**k // 1000}k" for k in _TICKS])
        axis.set_xticks([], minor=True)
        axis.tick_params(labelbottom=True, labelsize=7)
        axis.grid(alpha=0.3)
    axes[0][0].legend(fontsize=7)
    figure.tight_layout()
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=75, format="png")
    plt.close(figure)
