"""Stage 3: find the largest disocclusion, repair one component, look at the whole trajectory again (paper Sec. 3.3)."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from orca.anchors import GaussianAnchors
from orca.camera import Camera
from orca.config import RenderConfig, RepairConfig
from orca.conventions import Float32Array
from orca.field.decoders import Decoders
from orca.render.renderer import Renderer, Rendering
from orca.repair.components import Component, connected_components, drop_small
from orca.repair.detect import disocclusion_mask, mask_reach
from orca.repair.donors import FillTarget, local_fill
from orca.repair.generative import Alignment, GenerativeFailed, GenerativePriors, generative_fill
from orca.repair.hide import InputSurface, Trace, trace_in
from orca.repair.insert import InsertConfig, new_anchors
from orca.repair.ledger import Ledger, RepairRecord, run_lengths
from orca.repair.optimise import LocalTarget, optimise_new
from orca.repair.rules import Decision, RepairRules, order
from orca.repair.spacing import TargetCells, cells_of, split_cells
from orca.repair.views import Box, WatchedViews, crop_camera, grown
from orca.threads import map_on_cores, single_threaded_torch

__all__ = ["RepairResult", "repair"]

_RAYS_OPTIMISED = 4000  # at most; a larger hole is optimised on a random part of its pixels
_INPUT_TOLERANCE = 6 / 255  # change of a pixel of the input view that a repair may cause ...
# ... tried in turn where the input image is known.
_INPUT_TOLERANCES = tuple(x / 255 for x in (12, 6, 3, 1.5))
_INPUT_SHARE = 0.01  # of its squared error that all repairs together may add to the input view: 0.043 dB
_SMALLER = 0.6  # of its size, for a new anchor that would change it
_DONOR_ALPHA = 0.95
_BOUNDARY = 3  # pixels around the hole whose appearance is kept


@dataclass(frozen=True)
class RepairResult:
    """The scene's anchors with those of all repairs appended, and what was done."""

    anchors: GaussianAnchors
    ledger: Ledger


def repair(
    anchors: GaussianAnchors,
    decoders: Decoders,
    trajectory: Sequence[Camera],
    config: RepairConfig,
    render: RenderConfig,
    insert: InsertConfig,
    input_camera: Camera,
    seed: int = 0,
    progress: Callable[[str, int, int], None] = lambda phase, done, total: None,
    priors: GenerativePriors | None = None,
    input_image: Float32Array | None = None,
) -> RepairResult:
    """Close the disocclusions that a trajectory reveals. The given anchors keep every bit.

    Args:
        anchors: the scene after stage 2.
        decoders: its decoders; never changed here.
        trajectory: cameras along which holes are looked for; all of one size.
        config: thresholds, views, fill scheme.
        render: how the scene is rendered.
        insert: extents of new anchors.
        input_camera: the view that must stay as it is: nothing is inserted in front of what it sees.
        seed: of the choice of rays in large repairs.
        progress: called as progress(phase, done, total).
        priors: who completes large regions; None repairs them locally too, and the ledger says so.
        input_image: the input, [H, W, 3]. Where it is given, all repairs together add 1 % to the input view's squared
            error at most; without it no pixel of that view changes by more than 6/255.
    """
    indices = watched_indices(len(trajectory), config.views)
    cameras = [trajectory[i] for i in indices]
    first = cameras[0]
    rules = config.rules.scaled(first.width, first.height)
    loop = _Loop(anchors, decoders, cameras, indices, rules, config, render, insert, input_camera, seed, progress)
    loop.priors = priors
    loop.guard(input_image)
    with single_threaded_torch():
        records, stopped = loop.run()
    whole = 1e3 * loop.views.seconds
    ledger = Ledger(config.rules, rules, (first.width, first.height), tuple(records), stopped, len(cameras), whole)
    return RepairResult(loop.anchors, ledger)


def watched_indices(frames: int, views: int) -> list[int]:
    """Which frames of a trajectory are watched: all of them (``views`` 0), or so many evenly spaced ones."""
    if views <= 0 or views >= frames:
        return list(range(frames))
    return sorted({int(i) for i in np.linspace(0, frames - 1, views).round()})


class _Loop:
    """The state of one repair run."""

    def __init__(
        self,
        anchors: GaussianAnchors,
        decoders: Decoders,
        cameras: list[Camera],
        indices: list[int],
        rules: RepairRules,
        config: RepairConfig,
        render: RenderConfig,
        insert: InsertConfig,
        input_camera: Camera,
        seed: int,
        progress: Callable[[str, int, int], None],
    ) -> None:
        self.anchors, self.decoders, self.indices = anchors, decoders, indices
        self.rules, self.config, self.render, self.insert_config = rules, config, render, insert
        self.generator, self.progress = np.random.default_rng(seed), progress
        self.priors: GenerativePriors | None = None
        self.budget = rules.generative_budget  # generative completions that may still be tried
        self.views = WatchedViews(
            cameras, Renderer(anchors, decoders, render), lambda done, total: progress("repair: views", done, total)
        )
        self.input_view = WatchedViews([input_camera], self.views.renderer)
        self.surface = InputSurface.of(input_camera, self.input_view.rendered[0].depth)
        # Wider than the input, for what the outpainted margin hides.
        wide = input_camera.padded(*[min(input_camera.width, input_camera.height) // 4] * 4)
        seen = self.views.renderer.render(wide)
        self.shadow = InputSurface.sharp(wide, seen.depth, seen.alpha)
        # Pixels of a component that was repaired once and stays open: looked at again, they would be tried for ever.
        self.given_up = [np.zeros((c.height, c.width), bool) for c in cameras]
        self.open = [np.zeros((c.height, c.width), bool) for c in cameras]  # missing, components of any size
        self.missing = [self._missing(i, (0, 0, c.width, c.height)) for i, c in enumerate(cameras)]

        self.areas: list[int] = []
        self.input_image: Float32Array | None = None
        self.allowance = 0.0  # squared error that repairs may still add to the input view

    def guard(self, input_image: Float32Array | None) -> None:
        """Allow what repairs may add to the input view's error."""
        self.input_image = input_image
        if input_image is not None:
            error = np.square(np.clip(self.input_view.rendered[0].rgb, 0, 1) - input_image)
            self.allowance = _INPUT_SHARE * float(error.sum(dtype=np.float64))

    def run(self) -> tuple[list[RepairRecord], str]:
        """Repair until nothing large enough is missing or the iteration limit is reached."""
        records: list[RepairRecord] = []
        while len(records) < self.rules.max_iterations:
            self.progress("repair", len(records), self.rules.max_iterations)
            self.areas = [int(np.count_nonzero(m)) for m in self.missing]
            view = int(np.argmax(self.areas))
            components = connected_components(self.missing[view], self.rules.min_component_area, self.rules.bridge)
            if not components:
                return records, self._why("no disocclusion of the smallest area is left")
            share = self.areas[view] / self.missing[view].size
            if share < self.rules.enough:
                return records, self._why(f"no view misses more than {share:.2%}: under {self.rules.enough:.2%}")
            component, decision = order(components, self.budget, self.rules)[0]
            if decision.kind == "generative" and self.priors is None:
                decision = Decision("local", "no_inpainter", f"{decision.reason}, but there is no inpainter to ask")
            records.append(self._repair_one(len(records), view, component, decision))
        return records, self._why(f"the limit of {self.rules.max_iterations} repairs was reached")

    def _why(self, stopped: str) -> str:
        """Why repair stopped, and which views could not be repaired since nothing of the scene is in them."""
        blind = [str(self.indices[i]) for i, missing in enumerate(self.open) if missing.all()]
        return stopped + (f"; nothing of the scene is in view {', '.join(blind)}" if blind else "")

    def _missing(self, view: int, changed: Box) -> NDArray[np.bool_]:
        """Missing pixels of a view in components that are large enough, without those given up.

        Only around what has changed is the view looked at again. A view that sees nothing of the scene has nothing to
        fill its hole from: none of it counts.
        """
        rendered, camera = self.views.rendered[view], self.views.cameras[view]
        reach = mask_reach(self.rules)
        inner, outer = grown(changed, reach, camera), grown(changed, 2 * reach, camera)
        window = np.s_[outer[1] : outer[3], outer[0] : outer[2]]
        mask = disocclusion_mask(rendered.alpha[window], rendered.depth[window], self.rules)
        mask = mask[inner[1] - outer[1] : inner[3] - outer[1], inner[0] - outer[0] : inner[2] - outer[0]]
        target = np.s_[inner[1] : inner[3], inner[0] : inner[2]]
        self.open[view][target] = mask & ~self.given_up[view][target]
        if self.open[view].all():
            return np.zeros_like(self.open[view])
        return drop_small(self.open[view], self.rules.min_component_area, self.rules.bridge)

    def _repair_one(self, iteration: int, view: int, component: Component, decision: Decision) -> RepairRecord:
        started = time.perf_counter()
        camera, before = self.views.cameras[view], self.views.rendered[view]
        whole = component.full_mask(camera.height, camera.width)
        view_area, trajectory_area = self.areas[view], sum(self.areas)
        coverage_before = float(before.alpha[whole].mean())
        fill, decision, alignment = self._fill(before, component, camera, decision)
        generative = decision.kind == "generative"
        rules = replace(self.rules, max_anchors=self.config.generative.max_anchors) if generative else self.rules
        new = self._invisible_in_input(self._optimised(self._new(fill, camera, rules), component, fill, view))
        checking = time.perf_counter()
        self._insert(new, view, component.bbox, whole)
        checked, after = time.perf_counter(), self.views.rendered[view]
        return RepairRecord(
            iteration=iteration,
            view=self.indices[view],
            area=component.area,
            fill=component.fill,
            bbox=component.bbox,
            decision=decision.kind,
            rule=decision.rule,
            reason=decision.reason,
            donors=fill.donors,
            scheme=fill.scheme,
            anchors_added=len(new),
            coverage_before=coverage_before,
            coverage_after=float(after.alpha[whole].mean()),
            milliseconds=1e3 * (time.perf_counter() - started),
            view_area=view_area,
            trajectory_area=trajectory_area,
            mask=run_lengths(component.mask),
            checking_milliseconds=1e3 * (checked - checking),
            alignment=None if alignment is None else alignment.to_json(),
            foretold=fill.foretold,
        )

    def _new(self, fill: FillTarget, camera: Camera, rules: RepairRules) -> GaussianAnchors:
        """Anchors for a fill, behind what the input camera sees; those that cannot be are left out.

        Cells of several pixels that would show there all the same are taken apart, as long as the limit allows it.
        """
        cells = self._hidden(cells_of(fill, self.insert_config.cell_error, rules.max_anchors), camera)
        new = self._anchors_of(cells, camera)
        large = cells.sides > 1
        trace = self._trace(new) if large.any() else None
        shown = large & (trace is not None and trace.guilty(self._tolerance(trace)))
        if not shown.any():
            return new
        finer = self._hidden(split_cells(cells, shown, fill), camera)
        return self._anchors_of(finer, camera) if len(finer) <= rules.max_anchors else new

    def _hidden(self, cells: TargetCells, camera: Camera) -> TargetCells:
        """The cells moved behind what the input camera sees, without those for which there is no such place."""
        depth, hidden = self.surface.push_behind(camera, cells.centres, cells.depth)
        return replace(cells, depth=depth).subset(hidden)

    def _anchors_of(self, cells: TargetCells, camera: Camera) -> GaussianAnchors:
        return new_anchors(cells, camera, self.anchors, self.decoders, self.rules, self.insert_config)

    def _insert(self, new: GaussianAnchors, view: int, bbox: Box, component: NDArray[np.bool_]) -> None:
        """Add anchors to the scene and look at the whole trajectory again, where they can be seen."""
        touched: dict[int, Box] = {}
        if len(new):
            alone = self._alone(new)
            touched = self.views.insert(alone)
            self.input_view.insert(alone)
            self.views.renderer = self.input_view.renderer = self.views.renderer.extended(alone)
            self.anchors = self.views.renderer.anchors
        views = sorted(touched)
        for i, missing in zip(views, map_on_cores(lambda i: self._missing(i, touched[i]), views), strict=True):
            self.missing[i] = missing
        self.given_up[view] |= component & self.open[view]
        self.missing[view] = self._missing(view, bbox)

    def _invisible_in_input(self, new: GaussianAnchors) -> GaussianAnchors:
        """The new anchors, smaller where they would change the input view, and without those that still do."""
        trace = self._trace(new)
        if trace is None:
            return new
        guilty = trace.guilty(self._tolerance(trace))
        if not guilty.any():
            self.allowance -= max(0.0, float(trace.cost.sum()))
            return new
        smaller = torch.from_numpy(np.where(guilty, 2 * np.log(_SMALLER), 0.0).astype(np.float32))
        new = replace(new, log_variances=new.log_variances + smaller[:, None])
        trace = self._trace(new)
        if trace is None:
            return new
        tolerance = self._tolerance(trace)
        self.allowance -= max(0.0, trace.cost_within(tolerance))
        return new.subset(torch.from_numpy(~trace.guilty(tolerance)))

    def _tolerance(self, trace: Trace) -> float:
        """The largest change of an input pixel for which all that change less add no more than half the allowance."""
        if self.input_image is None:
            return _INPUT_TOLERANCE
        fits = (t for t in _INPUT_TOLERANCES if trace.cost_within(t) <= 0.5 * self.allowance)
        return next(fits, _INPUT_TOLERANCES[-1])

    def _trace(self, new: GaussianAnchors) -> Trace | None:
        """What new anchors change in the input view; None if they do not reach it."""
        if len(new) == 0:
            return None
        view, before = self.input_view, self.input_view.rendered[0].rgb
        return trace_in(self._alone(new), view.renderer, view.cameras[0], view.boxes[0], before, self.input_image)

    def _alone(self, new: GaussianAnchors) -> Renderer:
        """A renderer of new anchors alone."""
        return Renderer(new, self.decoders, self.render)

    def _fill(
        self, before: Rendering, component: Component, camera: Camera, decision: Decision
    ) -> tuple[FillTarget, Decision, Alignment | None]:
        """The target of a repair, and the decision as it came out: whatever fails generatively is repaired locally."""
        # Half-covered pixels are mixed with the background colour: no donors.
        valid = (before.alpha >= _DONOR_ALPHA) & (before.depth > 0)
        if not valid.any():
            valid = (before.alpha >= self.rules.alpha_threshold) & (before.depth > 0)
        least = self._least_depth(before.depth, valid, component, camera)
        local = local_fill(before.rgb, before.depth, valid, component, self.rules, self.config.fill, least)
        if decision.kind == "local" or self.priors is None:
            return local, decision, None
        self.budget -= 1  # a completion that fails has cost as much as one that works
        config = self.config.generative.scaled(camera.width, camera.height)
        try:
            made = generative_fill(before.rgb, before.depth, valid, component, local, camera, self.priors, config)
        except GenerativeFailed as error:
            reason = f"{decision.reason}; repaired locally because {error.given}"
            return local, Decision("local", "generative_failed", reason), None
        return made.target, decision, made.alignment

    def _least_depth(
        self, depth: Float32Array, valid: NDArray[np.bool_], component: Component, camera: Camera
    ) -> Float32Array:
        """How near the component's pixels may lie without being seen from the input, [H, W]; 0 elsewhere."""
        y, x = component.pixels()
        pixels = np.stack([x + 0.5, y + 0.5], 1)
        least = np.zeros(depth.shape, np.float32)
        near, far = 0.9 * float(depth[valid].min()), 1.1 * float(depth[valid].max())
        least[y, x] = self.shadow.least_depth(camera, pixels, near, far)
        return least

    def _optimised(self, new: GaussianAnchors, component: Component, fill: FillTarget, view: int) -> GaussianAnchors:
        """The new anchors fitted to the fill inside the hole and to the render as it was in a thin ring around it."""
        camera, before = self.views.cameras[view], self.views.rendered[view]
        x0, y0, x1, y1 = component.bbox
        box = (
            max(0, x0 - _BOUNDARY),
            max(0, y0 - _BOUNDARY),
            min(camera.width, x1 + _BOUNDARY),
            min(camera.height, y1 + _BOUNDARY),
        )
        wanted = before.rgb[box[1] : box[3], box[0] : box[2]].copy()
        inside = np.zeros(wanted.shape[:2], bool)
        wanted[fill.y - box[1], fill.x - box[0]] = fill.rgb
        inside[fill.y - box[1], fill.x - box[0]] = True
        kernel = np.ones((2 * _BOUNDARY + 1, 2 * _BOUNDARY + 1), np.uint8)
        rays = np.flatnonzero(cv2.dilate(inside.astype(np.uint8), kernel))
        if len(rays) > _RAYS_OPTIMISED:
            rays = np.sort(self.generator.choice(rays, _RAYS_OPTIMISED, replace=False))
        target = LocalTarget(crop_camera(camera, box), rays, wanted.reshape(-1, 3)[rays], inside.ravel()[rays])
        near = self.anchors.subset(torch.from_numpy(np.flatnonzero(self.views.reaching(view, box))))
        steps, opacity = self.rules.max_steps, self.rules.min_opacity
        return optimise_new(near, new, self.decoders, target, self.render, steps, opacity)
