"""The whole method on one page: one image, its depth and a trajectory in; a scene, a ledger and a record out."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch

from orca.anchors import GaussianAnchors, Stage
from orca.camera import Camera
from orca.config import GrowthConfig, ReconstructConfig
from orca.conventions import Float32Array
from orca.errors import BadInput
from orca.field.decoders import Decoders, analytic_decoders
from orca.field.hashing import HashEncoding
from orca.priors.choose import Priors
from orca.priors.depth import DepthEstimate
from orca.priors.hub import ModelAccess
from orca.progress import Progress
from orca.render.renderer import Renderer
from orca.repair.generative import GenerativePriors
from orca.repair.insert import InsertConfig
from orca.repair.loop import repair
from orca.scene import Scene
from orca.stages.canvas import Canvas, make_canvas
from orca.stages.deform import cleaned_depth, deform, log_depth_slopes, sample_depth
from orca.stages.growth import grow
from orca.stages.observations import GROWTH_RESOLUTION, MARGIN_RESOLUTION, Observation, observations
from orca.stages.planar import PlanarGrid, place, planar_anchors, rest_positions
from orca.stages.prune import reached
from orca.stages.residual import squared_of
from orca.stages.rims import shrink_rims
from orca.stages.solve import solve, with_colours
from orca.stages.train import TrainPlan, train
from orca.threads import single_threaded_blas

__all__ = ["Reconstruction", "reconstruct"]

_UNSEEN = 16 * 3 / 255**2  # squared error of sixteen pixels that are one level of 8 bits off


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """What `reconstruct` returns.

    Attributes:
        scene: the scene.
        ledger: the repair ledger as JSON-ready data (see `orca.repair.ledger.Ledger.to_json`).
        record: JSON-ready facts of the run: "seconds" per stage, "anchors" per stage, "input_psnr" after each
            stage, margins, training histories, why repair stopped.
    """

    scene: Scene
    ledger: dict[str, Any]
    record: dict[str, Any]


@dataclass
class _Run:
    """What the stages hand on: configuration, one generator, and the growing record."""

    config: ReconstructConfig
    device: str
    generator: torch.Generator
    progress: Progress
    record: dict[str, Any] = field(default_factory=lambda: {"seconds": {}, "input_psnr": {}})

    def timed(self, stage: str, started: float) -> None:
        self.record["seconds"][stage] = time.perf_counter() - started


def reconstruct(
    image: Float32Array,
    camera: Camera,
    depth: DepthEstimate,
    trajectory: Sequence[Camera],
    config: ReconstructConfig,
    *,
    priors: Priors | None = None,
    seed: int = 0,
    device: str = "cpu",
    progress: Progress | None = None,
) -> Reconstruction:
    """Reconstruct an explorable scene from one image (paper Sec. 3).

    Args:
        image: the input, [H, W, 3] float32 in [0, 1].
        camera: the input camera, identity pose, same size as the image.
        depth: z-depth of the input in the units of the trajectory.
        trajectory: cameras the scene will be seen from; decides canvas and repairs.
        config: every constant of the method.
        priors: who outpaints, inpaints and estimates depth of what they make; by default whoever the configuration
            names, with the weights that are on this machine.
        seed: of every random draw. Two runs with one seed on one machine and thread count give the same scene.
        device: "cpu" or a torch device for gradient training.
        progress: called as progress(phase, done, total).

    Raises:
        BadInput: image, camera, depth and trajectory do not fit together.
    """
    _check(image, camera, depth, trajectory)
    run = _Run(config, device, torch.Generator().manual_seed(seed), progress or (lambda phase, done, total: None))

    if depth.is_measured:
        config = run.config = config.trusting_depth()
    started = time.perf_counter()
    if priors is None:
        priors = Priors.of(config, ModelAccess(local_files_only=True, device=device), seed)
    canvas = make_canvas(image, depth.depth, camera, trajectory, config.canvas, priors.outpainter, priors.depth)
    failed = {"outpainter_failed": canvas.note} if canvas.note else {}
    run.record["priors"] = {**priors.to_json(), "margin_depth": canvas.margin_depth, **failed}
    observed = observations(canvas, MARGIN_RESOLUTION)
    run.timed("canvas", started)

    with single_threaded_blas():  # products of [N, 3] by [3, 3]: a second core costs more than it does
        lifted, decoders = _fitted(canvas, (camera, *trajectory), observed, run)

    started = time.perf_counter()
    anchors, ledger = _stage_repair(lifted, decoders, image, camera, trajectory, seed, priors, run)
    run.timed("repair", started)

    stages = torch.bincount(anchors.stage.long(), minlength=len(Stage)).tolist()
    run.record["anchors"] = {stage.name.lower(): int(n) for stage, n in zip(Stage, stages, strict=True)}
    run.record["margins"] = list(canvas.margins)
    run.record["canvas_scale"] = list(canvas.scale)
    _note_psnr(run, "final", anchors, decoders, observed[0])
    provenance = {
        "preset": config.name,
        "lifting": config.deform.lifting,
        "seed": seed,
        "depth_source": depth.source,
        "depth_is_metric": depth.is_metric,
        "depth_is_measured": depth.is_measured,
        "depth_notes": list(depth.notes),
        "margins": list(canvas.margins),
        "priors": run.record["priors"],
    }
    scene = Scene(anchors, decoders.cpu(), config.render, camera, provenance)
    return Reconstruction(scene, ledger, run.record)


def _check(image: Float32Array, camera: Camera, depth: DepthEstimate, trajectory: Sequence[Camera]) -> None:
    size = (camera.height, camera.width)
    if image.shape != (*size, 3) or depth.depth.shape != size or min(size) < 16 or not trajectory:
        raise BadInput(
            f"image {image.shape}, depth {depth.depth.shape}, camera {size}, {len(trajectory)} views to look from",
            "image [H, W, 3], depth [H, W] and camera of one size of at least 16x16, and at least one view",
            "make the sizes agree",
        )
    if not np.allclose(camera.world_to_camera, np.eye(4)):
        raise BadInput("an input camera that is not at the origin", "the identity pose", "move the trajectory instead")


def _fitted(
    canvas: Canvas, views: Sequence[Camera], observed: Sequence[Observation], run: _Run
) -> tuple[GaussianAnchors, Decoders]:
    """Stages 1 and 2, without the anchors that no view reaches."""
    started = time.perf_counter()
    surface = cleaned_depth(canvas.depth, run.config.deform)  # the depth that anchors are moved to
    grid, colours = _placed(canvas, surface, run)
    planar, decoders, encoding = _stage_planar(canvas, grid, colours, observed, run)
    run.timed("planar", started)

    started = time.perf_counter()
    lifted = _stage_deform(planar, decoders, encoding, canvas, surface, grid, observed, run)
    lifted = _pruned(lifted, decoders, views, run)
    run.timed("deform", started)
    return lifted, decoders


def _placed(canvas: Canvas, depth: Float32Array, run: _Run) -> tuple[PlanarGrid, Float32Array | None]:
    """Where the anchors sit: the preset's count at once, or grown as far as target, count or price ask for.

    To the preset's count anchors grow on the plane, which is stage 1's fit. With a limit on quality or a price they
    grow at the scene's depth, where those are to hold. The colours that growth ended with come back too.
    """
    config = run.config
    limits = _limits(canvas, config)
    if limits is None:
        run.record["growth"] = {"stopped": "the preset's count, placed at once", "curve": []}
        return place(canvas, config.planar), None

    def flat(grid: PlanarGrid) -> GaussianAnchors:
        return planar_anchors(canvas, grid, config.planar)

    growth = grow(
        canvas,
        observations(canvas, GROWTH_RESOLUTION),
        (lambda grid: _lift(flat(grid), grid, depth, canvas, config)) if config.growth.wanted else flat,
        config.planar,
        config.render,
        limits,
        lambda done, total: run.progress("growth", done, total),
    )
    run.record["growth"] = growth.to_json()
    if not config.growth.wanted:
        run.record["input_psnr"]["planar"] = growth.steps[-1].psnr_db
    return growth.grid, growth.colours


def _limits(canvas: Canvas, config: ReconstructConfig) -> GrowthConfig | None:
    """How far to grow: as far as the limits given ask for, else to the preset's count; None places that at once."""
    if config.growth.wanted:
        return config.growth
    if config.planar.placement.kind != "growth":
        return None
    count = round(config.planar.anchors_per_pixel * canvas.depth[canvas.original].size)
    return replace(config.growth, max_inside=count)


def _stage_planar(
    canvas: Canvas, grid: PlanarGrid, colours: Float32Array | None, observed: Sequence[Observation], run: _Run
) -> tuple[GaussianAnchors, Decoders, HashEncoding | None]:
    """Stage 1: planar anchors fitted to the original and the outpainted image.

    Without gradient steps in either stage there is nothing for the hash encoding to learn, and none is made. With
    one, the anchors' features include its contribution at all times.
    """
    config, planar = run.config, run.config.planar
    run.progress("planar fit", 0, 1)
    anchors = planar_anchors(canvas, grid, planar)
    encoding = None
    if planar.max_iterations + config.deform.max_iterations > 0:
        encoding = HashEncoding(rest_positions(canvas, grid), config.hash, run.generator)
    if planar.initialisation == "random":
        anchors = anchors.with_features(torch.zeros_like(anchors.features))
        decoders = Decoders(planar.use_direction, run.generator)
    else:
        decoders = analytic_decoders(planar.density, run.generator)
        if colours is not None:
            anchors = with_colours(anchors, colours)
        else:
            solved = solve(anchors, decoders, observed, planar, config.render)
            anchors, run.record["input_psnr"]["planar"] = solved.anchors, solved.after
    if encoding is not None:
        anchors = anchors.with_features(anchors.features + encoding().detach())
    plan = TrainPlan(planar.max_iterations, 0, not planar.freeze_geometry, not planar.freeze_geometry)
    anchors = _train(anchors, decoders, encoding, observed, plan, "planar fit", run)
    if planar.max_iterations > 0:
        _note_psnr(run, "planar", anchors, decoders, observed[0])
    run.progress("planar fit", 1, 1)
    return anchors, decoders, encoding


def _stage_deform(
    anchors: GaussianAnchors,
    decoders: Decoders,
    encoding: HashEncoding | None,
    canvas: Canvas,
    depth: Float32Array,
    grid: PlanarGrid,
    observed: Sequence[Observation],
    run: _Run,
) -> GaussianAnchors:
    """Stage 2: anchors move along their rays to the scene's depth; then everything but the means is fitted again."""
    config = run.config
    run.progress("depth deformation", 0, 1)
    lifted = _place(_lift(anchors, grid, depth, canvas, config), canvas, run)
    psnr = run.record["input_psnr"]
    if config.planar.initialisation == "closed_form":
        solved = solve(lifted, decoders, observed, config.planar, config.render)
        lifted, psnr["deformed"], psnr["fine_tuned"] = solved.anchors, solved.before, solved.after
    else:
        _note_psnr(run, "deformed", lifted, decoders, observed[0])
    plan = TrainPlan(config.deform.max_iterations, config.deform.arm_after, False, True)
    lifted = _train(lifted, decoders, encoding, observed, plan, "fine-tuning", run)
    if "fine_tuned" not in psnr or plan.max_iterations > 0:
        _note_psnr(run, "fine_tuned", lifted, decoders, observed[0])
    run.progress("depth deformation", 1, 1)
    return lifted


def _place(anchors: GaussianAnchors, canvas: Canvas, run: _Run) -> GaussianAnchors:
    """Bring the scene to the trajectory's scale: the median ratio of its depth to the provider's becomes one.

    Metric lifting has that ratio everywhere. Relative lifting bends planes, so the ratio varies: its spread (84th
    over 16th percentile) is recorded as the mismatch.
    """
    inner = anchors.stage == int(Stage.ORIGINAL)
    means = anchors.means[inner].double().numpy()
    pixels, z = canvas.camera.project(means)
    ratio = z / sample_depth(canvas.depth, pixels)
    low, scale, high = (float(q) for q in np.quantile(ratio, [0.16, 0.5, 0.84]))
    run.record["placement"] = {"scale": 1 / scale, "spread": high / low}
    if run.config.deform.lifting == "metric":
        return anchors
    return replace(anchors, means=anchors.means / scale, log_variances=anchors.log_variances - 2 * float(np.log(scale)))


def _lift(
    anchors: GaussianAnchors, grid: PlanarGrid, depth: Float32Array, canvas: Canvas, config: ReconstructConfig
) -> GaussianAnchors:
    """Planar anchors at the scene's depth; those beside depth edges end where the far surface begins."""
    anchors = deform(anchors, depth, canvas.camera, config.deform)
    if config.planar.initialisation != "closed_form":
        return anchors
    focal = np.diag(canvas.camera.K)[:2]
    slopes = log_depth_slopes(depth, grid.pixels, canvas.camera, config.deform.max_slope) / focal
    reach = math.sqrt(config.render.chi2) * config.planar.kappa * grid.spacing
    rims = (config.deform.rim_ratio, config.deform.rim_extent, config.deform.rim_clearance)
    return shrink_rims(anchors, grid.pixels, reach, depth, *rims, slopes)


def _pruned(anchors: GaussianAnchors, decoders: Decoders, views: Sequence[Camera], run: _Run) -> GaussianAnchors:
    """Anchors that some view reaches; the views show the same without the others."""
    if not run.config.prune:
        return anchors
    used = reached(Renderer(anchors, decoders.cpu(), run.config.render), views)
    run.record["pruned"] = int((~used).sum())
    return anchors.subset(torch.from_numpy(np.flatnonzero(used)))


def _train(
    anchors: GaussianAnchors,
    decoders: Decoders,
    encoding: HashEncoding | None,
    observed: Sequence[Observation],
    plan: TrainPlan,
    phase: str,
    run: _Run,
) -> GaussianAnchors:
    """Gradient training, where the plan has any."""
    if plan.max_iterations == 0 or encoding is None:
        return anchors
    decoders.to(run.device)
    encoding.to(run.device)
    result = train(
        anchors.to(run.device),
        decoders,
        encoding,
        observed,
        plan,
        run.config.train,
        run.config.render,
        run.generator,
        lambda done, total: run.progress(phase, done, total),
    )
    run.record.setdefault("history", {})[phase] = {
        "iterations": result.iterations,
        "stopped": result.stopped,
        "evaluations": [list(row) for row in result.history],
    }
    return result.anchors.to("cpu")


def _stage_repair(
    anchors: GaussianAnchors,
    decoders: Decoders,
    image: Float32Array,
    input_camera: Camera,
    trajectory: Sequence[Camera],
    seed: int,
    priors: Priors,
    run: _Run,
) -> tuple[GaussianAnchors, dict[str, Any]]:
    """Stage 3: disocclusion repair along the trajectory."""
    config = run.config
    if not config.repair.enabled:
        return anchors, {"schema_version": 1, "repairs": [], "stopped": "repair is off"}
    insert = InsertConfig(config.planar.kappa, config.planar.colour_clip, cell_error=_cell_error(anchors, image, run))
    completes = None if priors.inpainter is None else GenerativePriors(priors.inpainter, priors.depth)
    result = repair(
        anchors,
        decoders.cpu(),
        trajectory,
        config.repair,
        config.render,
        insert,
        input_camera,
        seed,
        run.progress,
        completes,
        image,
    )
    run.record["repair_stopped"] = result.ledger.stopped
    return result.anchors, result.ledger.to_json()


def _cell_error(anchors: GaussianAnchors, image: Float32Array, run: _Run) -> float:
    """Squared error that a repair's anchor may leave of four or more pixels rather than give each its own.

    The three anchors saved must not be worth more there than in the image, where twice the anchors leave a quarter of
    the error (6 dB, reports/anchors): one more takes off twice what each leaves. What 8 bits hardly show is left in
    any case.
    """
    if run.config.repair.spread == "even":
        return 0.0
    inside = max(1, int((anchors.stage == int(Stage.ORIGINAL)).sum()))
    left = squared_of(run.record["input_psnr"]["fine_tuned"], image[..., 0].size) / inside
    return max(3 * 2 * left, _UNSEEN)


def _note_psnr(run: _Run, stage: str, anchors: GaussianAnchors, decoders: Decoders, observation: Observation) -> None:
    """Record how well the input view is reproduced, in dB."""
    rendered = Renderer(anchors, decoders.cpu(), run.config.render).render(observation.camera)
    error = np.clip(rendered.rgb.reshape(-1, 3)[observation.rays], 0, 1) - observation.colour
    run.record["input_psnr"][stage] = float(-10 * np.log10(max(float(np.square(error).mean()), 1e-12)))
