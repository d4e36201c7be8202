"""Quality against anchors: regular grids, and anchors grown by residual, on one picture (METHOD.md 1.2).

Both are fitted to the input image alone, on the plane and without a margin, so that they are counted alike: grown to
some counts, and to a quality, which is timed in turns with the finest grid.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import torch

from bench.datasets.case import SceneCase
from orca.anchors import GaussianAnchors
from orca.config import GrowthConfig, PlacementConfig, ReconstructConfig
from orca.conventions import to_float
from orca.field.decoders import Decoders, analytic_decoders
from orca.render.renderer import Renderer
from orca.stages.canvas import Canvas
from orca.stages.growth import grow
from orca.stages.observations import observations
from orca.stages.planar import place, planar_anchors
from orca.stages.solve import solve_colours, with_colours

__all__ = ["COUNTS", "GRIDS", "CurvePoint", "Goal", "SceneCurve", "measure_curve", "needed"]

GRIDS = (0.25, 0.5, 1.0)
"""Anchors per pixel of the regular grids."""

COUNTS = (1 / 16, 1 / 8, 1 / 4, 1 / 2)
"""Anchors per pixel that are grown to; those beyond `Goal.at_least` only where the goal takes more."""

_TURNS = 3  # of the finest grid and of growing to the goal; medians count


@dataclass(frozen=True)
class Goal:
    """What to reach, in dB; how many anchors per pixel to grow to in any case; and the price in dB per 1,000 anchors
    at which growing ends before."""

    psnr_db: float = 40.0
    at_least: float = 0.25
    price: float = 0.1


@dataclass(frozen=True)
class CurvePoint:
    """One fit: which ``placement`` ("grid", "grown" to a count, grown to the "target", or to the "knee": where target
    or price stop), how many anchors, PSNR, CPU seconds of all that led to it, CPU milliseconds of a frame, and why
    growing stopped."""

    placement: str
    anchors: int
    psnr_db: float
    fit_cpu_s: float
    frame_cpu_ms: float
    why: str = ""


@dataclass(frozen=True)
class SceneCurve:
    """All fits of one scene, grown towards ``target_db`` or until a thousand anchors gain less than ``price_db``."""

    scene: str
    target_db: float
    price_db: float
    points: tuple[CurvePoint, ...]

    @property
    def pixels(self) -> int:
        """Of the image: the finest grid has an anchor for each."""
        return max(p.anchors for p in self.points if p.placement == "grid")

    def grid(self, per_pixel: float) -> CurvePoint:
        """The regular grid with about so many anchors per pixel."""
        points = [p for p in self.points if p.placement == "grid"]
        return min(points, key=lambda p: abs(p.anchors - per_pixel * self.pixels))

    @property
    def reached(self) -> CurvePoint:
        """Where growing to the goal ended."""
        return next(p for p in self.points if p.placement == "target")

    @property
    def grown(self) -> list[CurvePoint]:
        """The curve, grown to counts and to the target, fewest anchors first."""
        return sorted((p for p in self.points if p.placement in ("grown", "target")), key=lambda p: p.anchors)

    def grown_at(self, per_pixel: float) -> CurvePoint:
        """The point of the curve with about so many anchors per pixel."""
        return min(self.grown, key=lambda p: abs(p.anchors - per_pixel * self.pixels))

    @property
    def knee(self) -> CurvePoint:
        """Where target and price together stop."""
        return next(p for p in self.points if p.placement == "knee")

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self)

    def rows(self) -> list[dict[str, Any]]:
        """One flat row a point."""
        return [
            {"scene": self.scene, "target_db": self.target_db, "price_db": self.price_db, **asdict(p)}
            for p in self.points
        ]

    @staticmethod
    def of_rows(rows: Sequence[dict[str, str]]) -> SceneCurve:
        """The curve that `rows` were written from, as CSV reads them."""
        points = tuple(
            CurvePoint(
                row["placement"],
                int(row["anchors"]),
                float(row["psnr_db"]),
                float(row["fit_cpu_s"]),
                float(row["frame_cpu_ms"]),
                row["why"],
            )
            for row in rows
        )
        return SceneCurve(rows[0]["scene"], float(rows[0]["target_db"]), float(rows[0]["price_db"]), points)


def needed(curve: SceneCurve, psnr_db: float) -> float | None:
    """Anchors that growing needs for a PSNR, between points by a straight line; None where it was not reached."""
    points: Sequence[CurvePoint] = curve.grown
    for i, point in enumerate(points):
        if point.psnr_db >= psnr_db:
            if i == 0:
                return float(point.anchors)
            low = points[i - 1]
            share = (psnr_db - low.psnr_db) / (point.psnr_db - low.psnr_db)
            return low.anchors + share * (point.anchors - low.anchors)
    return None


def measure_curve(case: SceneCase, config: ReconstructConfig, goal: Goal) -> SceneCurve:
    """Fit one scene's image with every grid, and grow to the goal and to some counts."""
    canvas = Canvas(to_float(case.image), case.depth, case.camera, (0, 0, 0, 0))
    _grid(canvas, GRIDS[0], config)  # a process's first fit loads kernels
    points = [_grid(canvas, per_pixel, config) for per_pixel in GRIDS[:-1]]
    target, knee = GrowthConfig(target_psnr=goal.psnr_db), GrowthConfig(target_psnr=goal.psnr_db, price=goal.price)
    turns = [(_grid(canvas, GRIDS[-1], config), _to_limits("target", canvas, config, target)) for _ in range(_TURNS)]
    finest, reached = (_median([turn[i] for turn in turns]) for i in range(2))
    counts = [round(share * canvas.depth.size) for share in COUNTS if share <= goal.at_least]
    counts += [n for n in (round(s * canvas.depth.size) for s in COUNTS) if counts[-1] < n < reached.anchors]
    grown = [_to_count(canvas, config, count) for count in counts]
    chosen = _to_limits("knee", canvas, config, knee)
    return SceneCurve(case.name, goal.psnr_db, goal.price, (*points, finest, *grown, reached, chosen))


def _median(turns: Sequence[CurvePoint]) -> CurvePoint:
    """One fit measured several times."""
    seconds, frame = (statistics.median(getattr(t, key) for t in turns) for key in ("fit_cpu_s", "frame_cpu_ms"))
    return replace(turns[0], fit_cpu_s=seconds, frame_cpu_ms=frame)


def _grid(canvas: Canvas, per_pixel: float, config: ReconstructConfig) -> CurvePoint:
    """The optimum of a regular grid."""
    started = time.process_time()
    planar = replace(config.planar, placement=PlacementConfig(kind="grid"), anchors_per_pixel=per_pixel)
    anchors = planar_anchors(canvas, place(canvas, planar), planar)
    return _seen("grid", canvas, _solved(canvas, anchors, config), config, started)


def _to_count(canvas: Canvas, config: ReconstructConfig, count: int) -> CurvePoint:
    """Grown to a count, then solved as often as a grid is."""
    started = time.process_time()
    grown, why = _grown(canvas, config, GrowthConfig(max_anchors=count))
    return replace(_seen("grown", canvas, _solved(canvas, grown, config), config, started), why=why)


def _to_limits(placement: str, canvas: Canvas, config: ReconstructConfig, limits: GrowthConfig) -> CurvePoint:
    """Grown to a quality or a price, and no further."""
    started = time.process_time()
    anchors, why = _grown(canvas, config, limits)
    return replace(_seen(placement, canvas, anchors, config, started), why=why)


def _grown(canvas: Canvas, config: ReconstructConfig, limits: GrowthConfig) -> tuple[GaussianAnchors, str]:
    growth = grow(
        canvas,
        observations(canvas, 1.0),
        lambda grid: planar_anchors(canvas, grid, config.planar),
        config.planar,
        config.render,
        limits,
    )
    return with_colours(planar_anchors(canvas, growth.grid, config.planar), growth.colours), growth.stopped


def _solved(canvas: Canvas, anchors: GaussianAnchors, config: ReconstructConfig) -> GaussianAnchors:
    observed = observations(canvas, 1.0)
    return solve_colours(anchors, _decoders(config), observed, config.planar, config.render)


def _decoders(config: ReconstructConfig) -> Decoders:
    return analytic_decoders(config.planar.density, torch.Generator().manual_seed(0))


def _seen(
    placement: str, canvas: Canvas, anchors: GaussianAnchors, config: ReconstructConfig, started: float
) -> CurvePoint:
    """Stop the clock of the fit and look at the picture."""
    seconds = time.process_time() - started
    renderer, camera = Renderer(anchors, _decoders(config), config.render), observations(canvas, 1.0)[0].camera
    started = time.process_time()
    seen = renderer.render(camera).rgb
    frame = 1000 * (time.process_time() - started)
    error = float(np.square(np.clip(seen, 0, 1) - canvas.image).mean())
    return CurvePoint(placement, len(anchors), -10 * math.log10(max(error, 1e-12)), seconds, frame)
