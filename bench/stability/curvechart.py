"""Curves of quality against disturbance as CSV and as a picture."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bench.stability.curves import EQUAL_DB, VIEWS, seed_spread
from bench.stability.disturb import DISTURBANCES
from orca.atomic import atomic_path

__all__ = ["curves_csv", "curves_text", "write_curves"]

_COLUMNS = ("disturbance", "level", "method", *VIEWS, "outcome", "detail", "seconds", "cpu_s")
_LINES = {"input_psnr": ("--", "input view"), "second_psnr": ("-", "second view")}


def curves_csv(rows: Sequence[dict[str, Any]]) -> str:
    """One line a point."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for row in rows:
        writer.writerow([_plain(row[key]) for key in _COLUMNS])
    return out.getvalue()


def curves_text(rows: Sequence[dict[str, Any]]) -> str:
    """The points by disturbance and method, and the spread over seeds, for people."""
    lines = []
    for kind in dict.fromkeys(row["disturbance"] for row in rows):
        lines.append(f"{DISTURBANCES[kind].axis}: PSNR of input view / second view [dB]")
        for method in dict.fromkeys(row["method"] for row in rows if row["disturbance"] == kind):
            found = [row for row in rows if (row["disturbance"], row["method"]) == (kind, method)]
            points = "  ".join(f"{row['level']:g}: {_pair(row)}" for row in found)
            lines.append(f"  {method}  {points}")
            spread = seed_spread(found, method)
            if spread:
                told = ", ".join(f"{_LINES[view][1]} {value:.3f} dB" for view, value in spread.items())
                lines.append(f"  {method}  standard deviation over {len(found)} seeds: {told}")
    return "\n".join(lines)


def write_curves(rows: Sequence[dict[str, Any]], folder: Path) -> tuple[Path, Path]:
    """Write ``curves.csv`` and ``curves.png``; returns their paths."""
    table, picture = folder / "curves.csv", folder / "curves.png"
    with atomic_path(table) as temporary:
        temporary.write_text(curves_csv(rows), encoding="utf-8")
    _draw(rows, picture)
    return table, picture


def _pair(row: dict[str, Any]) -> str:
    if row["second_psnr"] is None:
        return str(row["outcome"])
    return " / ".join(f"{row[view]:.2f}" for view in VIEWS)


def _plain(value: Any) -> Any:
    return "" if value is None else f"{value:.4f}".rstrip("0").rstrip(".") if isinstance(value, float) else value


def _draw(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """A panel a disturbance: PSNR of the second view (full) and of the input view (dashed), a colour a method."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    kinds = list(dict.fromkeys(row["disturbance"] for row in rows))
    colours = {method: f"C{i}" for i, method in enumerate(dict.fromkeys(row["method"] for row in rows))}
    figure, axes = plt.subplots(1, len(kinds), figsize=(3.0 * len(kinds), 3.2), squeeze=False)
    for kind, axis in zip(kinds, axes[0], strict=True):
        for method, colour in colours.items():
            for view, (style, words) in _LINES.items():
                found = [r for r in rows if (r["disturbance"], r["method"]) == (kind, method) and r[view] is not None]
                points = [(row["level"], row[view]) for row in found if row[view] < EQUAL_DB]
                if not points:  # a method that shows the input itself has no curve there
                    continue
                marker = "o" if view == "second_psnr" else "."
                axis.plot(*zip(*points), style, marker=marker, ms=4, color=colour, label=f"{method}, {words}")
        axis.set(xlabel=DISTURBANCES[kind].axis)
        axis.grid(alpha=0.3)
    if "jpeg" in kinds:
        axes[0][kinds.index("jpeg")].invert_xaxis()
    axes[0][0].set_ylabel("PSNR [dB]")
    drawn = [axis.get_legend_handles_labels() for axis in axes[0]]
    handles = {label: handle for some, words in drawn for handle, label in zip(some, words, strict=True)}
    figure.legend(handles.values(), handles.keys(), loc="lower center", ncols=3, fontsize=7, frameon=False)
    figure.tight_layout(rect=(0, 0.13, 1, 1))
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=80)
    plt.close(figure)
