"""Quality against anchors: regular grids, and anchors grown by residual, on one picture (METHOD.md 1.2).

Both are fitted to the input image alone, on the plane and without a margin, so that they are counted alike.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import torch

from bench.datasets.case import SceneCase
from orca.anchors import GaussianAnchors
from orca.config import GrowthConfig, PlacementConfig, PlanarConfig, ReconstructConfig
from orca.conventions import to_float
from orca.field.decoders import analytic_decoders
from orca.render.renderer import Renderer
from orca.stages.canvas import Canvas
from orca.stages.growth import grow
from orca.stages.observations import observations
from orca.stages.planar import place, planar_anchors
from orca.stages.solve import solve_colours, with_colours

__all__ = ["GRIDS", "CurvePoint", "Goal", "SceneCurve", "measure_curve", "needed"]

GRIDS = (0.25, 0.5, 1.0)
"""Anchors per pixel of the regular grids."""

_OCTAVE = 3  # rounds from a count to twice as many


@dataclass(frozen=True)
class Goal:
    """When the curve may end: at this PSNR in dB, with at most so many anchors per pixel, but not before
    ``at_least`` anchors per pixel; and the price in dB per 1,000 anchors that marks the knee."""

    psnr_db: float = 40.0
    most: float = 0.75
    at_least: float = 0.25
    price: float = 0.05


@dataclass(frozen=True)
class CurvePoint:
    """One fit: which ``placement`` ("grid" or "grown"), how many anchors, PSNR, CPU seconds of all that led to it,
    and CPU milliseconds of a frame where one was rendered."""

    placement: str
    anchors: int
    psnr_db: float
    fit_cpu_s: float
    frame_cpu_ms: float | None = None


@dataclass(frozen=True)
class SceneCurve:
    """All fits of one scene, grown towards ``target_db``."""

    scene: str
    target_db: float
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
        """Where growing met the goal, or ended: the first point of it that was rendered."""
        return next(p for p in self.grown if p.frame_cpu_ms is not None)

    @property
    def grown(self) -> list[CurvePoint]:
        """The curve, fewest anchors first."""
        return [p for p in self.points if p.placement == "grown"]

    def grown_at(self, per_pixel: float) -> CurvePoint:
        """The round of growing with about so many anchors per pixel."""
        return min(self.grown, key=lambda p: abs(p.anchors - per_pixel * self.pixels))

    def knee(self, goal: Goal) -> tuple[CurvePoint, str]:
        """Where target and price together stop, and which of them did."""
        before = None
        for point in self.grown:
            if point.psnr_db >= goal.psnr_db:
                return point, "target"
            if before is not None:
                gain = (point.psnr_db - before.psnr_db) / (point.anchors - before.anchors) * 1000
                if gain < goal.price:
                    return point, "price"
            before = point
        return self.grown[-1], "count"

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self)

    def rows(self) -> list[dict[str, Any]]:
        """One flat row a point."""
        return [{"scene": self.scene, "target_db": self.target_db, **asdict(p)} for p in self.points]

    @staticmethod
    def of_rows(rows: Sequence[dict[str, str]]) -> SceneCurve:
        """The curve that `rows` were written from, as CSV reads them."""
        points = tuple(
            CurvePoint(
                row["placement"],
                int(row["anchors"]),
                float(row["psnr_db"]),
                float(row["fit_cpu_s"]),
                float(row["frame_cpu_ms"]) if row["frame_cpu_ms"] else None,
            )
            for row in rows
        )
        return SceneCurve(rows[0]["scene"], float(rows[0]["target_db"]), points)


def needed(curve: SceneCurve, psnr_db: float) -> float | None:
    """Anchors that growing needs for a PSNR, between rounds by a straight line; None where it was not reached."""
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
    """Fit one scene's image with every grid, then grow."""
    canvas = Canvas(to_float(case.image), case.depth, case.camera, (0, 0, 0, 0))
    points = [_grid(canvas, per_pixel, config) for per_pixel in GRIDS]
    return SceneCurve(case.name, goal.psnr_db, (*points, *_grown(canvas, config, goal)))


def _grid(canvas: Canvas, per_pixel: float, config: ReconstructConfig) -> CurvePoint:
    """The optimum of a regular grid."""
    placement = PlacementConfig(kind="grid")
    planar = replace(config.planar, placement=placement, anchors_per_pixel=per_pixel)
    started = time.process_time()
    anchors = planar_anchors(canvas, place(canvas, planar), planar)
    return _finished("grid", canvas, anchors, planar, config, started)


def _grown(canvas: Canvas, config: ReconstructConfig, goal: Goal) -> list[CurvePoint]:
    """Grown to the goal; where that takes fewer than ``goal.at_least`` anchors, on to as many as that too."""
    pixels, growth = canvas.depth.size, 2 ** (1 / _OCTAVE)
    least = round(goal.at_least * pixels)
    limits = GrowthConfig(
        max_anchors=round(goal.most * pixels), target_psnr=goal.psnr_db, growth=growth, start_per_pixel=1 / 16
    )
    points = _growing(canvas, config, limits)
    if points[-1].anchors < least - 2:
        more = _growing(canvas, config, replace(limits, max_anchors=least, target_psnr=None))
        points += [p for p in more if p.anchors > points[-1].anchors]
    return points


def _growing(canvas: Canvas, config: ReconstructConfig, limits: GrowthConfig) -> list[CurvePoint]:
    planar, started, at = config.planar, time.process_time(), list[float]()
    growth = grow(
        canvas,
        observations(canvas, 1.0),
        lambda grid: planar_anchors(canvas, grid, planar),
        planar,
        config.render,
        limits,
        lambda done, total: at.append(time.process_time() - started),
    )
    points = [CurvePoint("grown", s.anchors, s.psnr_db, t) for s, t in zip(growth.steps, at, strict=True)]
    anchors = with_colours(planar_anchors(canvas, growth.grid, planar), growth.colours)
    last = replace(planar, gauss_newton_steps=1)
    points[-1] = _finished("grown", canvas, anchors, last, config, started)
    return points


def _finished(
    placement: str,
    canvas: Canvas,
    anchors: GaussianAnchors,
    planar: PlanarConfig,
    config: ReconstructConfig,
    started: float,
) -> CurvePoint:
    """Solve once more and look at the picture."""
    observed = observations(canvas, 1.0)
    decoders = analytic_decoders(planar.density, torch.Generator().manual_seed(0))
    solved = solve_colours(anchors, decoders, observed, planar, config.render)
    seconds = time.process_time() - started
    renderer = Renderer(solved, decoders, config.render)
    started = time.process_time()
    seen = renderer.render(observed[0].camera).rgb
    frame = 1000 * (time.process_time() - started)
    error = float(np.square(np.clip(seen, 0, 1) - canvas.image).mean())
    return CurvePoint(placement, len(solved), -10 * math.log10(max(error, 1e-12)), seconds, frame)
