"""What the verbs of the command line do: each returns a JSON-ready document and a text for people."""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from orca.atomic import atomic_path, drop_unfinished, output_folder
from orca.camera import Camera
from orca.compilation import told_of_compilation
from orca.config import ReconstructConfig, get_preset
from orca.conventions import Float32Array, to_float
from orca.errors import BadInput, Unavailable
from orca.images import load_image
from orca.placement import FieldOfView, choose_field_of_view, path_in_scene_radii
from orca.priors.choose import Priors
from orca.priors.depth import DepthEstimate, DepthProvider, parse_depth_spec
from orca.priors.hub import ModelAccess
from orca.progress import PhaseBars
from orca.scene import Scene

__all__ = ["info", "reconstruct", "render"]

Answer = tuple[dict[str, object], str]

_DEPTH_SUFFIXES = (".depth.png", ".depth.npy", "_depth.png", "_depth.npy")


def reconstruct(arguments: argparse.Namespace) -> Answer:
    """Image in, folder out: scene, preview, ledger, configuration and timings."""
    from orca.ledger_picture import write_ledger_picture
    from orca.paths import scene_radius
    from orca.pipeline import reconstruct as run_pipeline
    from orca.preview import write_preview

    config = _config(arguments)
    check_device(arguments.device)
    image = to_float(load_image(arguments.image))
    folder = output_folder(arguments.out)
    drop_unfinished(folder)
    started = time.perf_counter()
    access = ModelAccess(arguments.weights_dir, arguments.local_files_only, arguments.device)
    priors, provider = Priors.of(config, access, arguments.seed), _depth_provider(arguments, access)
    depth, view, camera = _geometry(arguments, image, provider)
    priors = priors.using(provider)
    seconds = {"depth": time.perf_counter() - started}
    radius = scene_radius(depth.depth, camera)
    cameras = path_in_scene_radii(arguments.trajectory, arguments.frames, camera, radius)
    in_radii = replace(depth, depth=depth.depth / np.float32(radius))
    with PhaseBars() as bars, told_of_compilation(bars):
        result = run_pipeline(
            image,
            camera,
            in_radii,
            cameras,
            config,
            priors=priors,
            seed=arguments.seed,
            device=arguments.device,
            progress=bars,
        )
        facts = _facts(arguments, depth, view, radius)
        scene = replace(result.scene, provenance={**result.scene.provenance, **facts})
        scene.save(folder / "scene.safetensors")
        started = time.perf_counter()
        video, picture = folder / "preview.mp4", folder / "preview.png"
        holes = write_preview(scene, cameras, video, picture, arguments.fps, arguments.device, bars)
    seconds = {**seconds, **result.record["seconds"], "preview": time.perf_counter() - started}
    _write_json(folder / "ledger.json", result.ledger)
    write_ledger_picture(scene, cameras, result.ledger, folder / "ledger.png")
    _write_json(folder / "config.json", {**config.to_json(), "run": {**facts, "growth": result.record["growth"]}})
    _write_json(folder / "timings.json", {"schema_version": 1, "seconds": seconds, "record": result.record})
    document, text = _reconstruct_answer(scene, result.record, seconds, folder, depth, holes)
    ends, lines = _ends(result.record, result.ledger, config, camera)
    return {**document, **ends}, "\n".join([text, *lines])


def render(arguments: argparse.Namespace) -> Answer:
    """Scene and path in, video out."""
    from orca.preview import write_preview

    check_device(arguments.device)
    scene = Scene.load(arguments.scene)
    radius = float(scene.provenance.get("scene_radius", 1.0))
    cameras = path_in_scene_radii(arguments.trajectory, arguments.frames, scene.camera, radius)
    started = time.perf_counter()
    with PhaseBars() as bars, told_of_compilation(bars):
        write_preview(scene, cameras, arguments.out, None, arguments.fps, arguments.device, bars)
    seconds = time.perf_counter() - started
    document: dict[str, object] = {
        "video": str(arguments.out),
        "frames": len(cameras),
        "seconds": seconds,
        "ms_per_frame": 1000 * seconds / len(cameras),
    }
    return document, f"{arguments.out}: {len(cameras)} frames in {seconds:.1f} s"


def info(arguments: argparse.Namespace) -> Answer:
    """What a scene file holds."""
    scene = Scene.load(arguments.scene)
    stages = np.bincount(scene.anchors.stage.numpy(), minlength=3).tolist()
    camera = scene.camera
    document: dict[str, object] = {
        "scene": str(arguments.scene),
        "bytes": arguments.scene.stat().st_size,
        "anchors": scene.num_anchors,
        "anchors_by_stage": dict(zip(("original", "outpainted", "repaired"), stages)),
        "camera": {"width": camera.width, "height": camera.height, "hfov_deg": camera.hfov_deg},
        "provenance": scene.provenance,
    }
    lines = [f"{key:17} {value}" for key, value in document.items() if key != "provenance"]
    lines += [f"{key:17} {value}" for key, value in sorted(scene.provenance.items())]
    return document, "\n".join(lines)


def check_device(device: str) -> None:
    """Raise `BadInput` for a device that is not one, and `Unavailable` for one that this machine does not have."""
    import torch

    if device not in ("cpu", "cuda"):
        raise BadInput(f"device '{device}'", "cpu or cuda", "use --device cpu")
    if device == "cuda" and not torch.cuda.is_available():
        raise Unavailable("no CUDA device that torch can use", "cpu, or cuda where there is one", "use --device cpu")


def _config(arguments: argparse.Namespace) -> ReconstructConfig:
    """The preset with what the user changed."""
    config = get_preset(arguments.preset)
    if arguments.lifting is not None:
        config = config.with_lifting(arguments.lifting)
    limits = {"target_psnr": arguments.target_psnr, "max_anchors": arguments.max_anchors, "price": arguments.price}
    config = replace(config, growth=replace(config.growth, **limits))
    if arguments.outpainter is not None:
        config = replace(config, canvas=replace(config.canvas, outpainter=arguments.outpainter))
    if arguments.inpainter is not None:
        config = replace(config, repair=replace(config.repair, inpainter=arguments.inpainter))
    return config


def _depth_provider(arguments: argparse.Namespace, access: ModelAccess) -> DepthProvider:
    """The provider asked for; ``auto``, which is the default, takes a depth file beside the image first."""
    spec = arguments.depth or "auto"
    if spec.partition(":")[0].partition("?")[0] == "auto":
        spec = _depth_beside(arguments.image) or spec
    return parse_depth_spec(spec, access)


def _geometry(
    arguments: argparse.Namespace, image: Float32Array, provider: DepthProvider
) -> tuple[DepthEstimate, FieldOfView, Camera]:
    """Depth of the image, its field of view and its camera."""
    height, width = image.shape[:2]
    guess = choose_field_of_view(arguments.hfov, None, arguments.trajectory)
    depth = provider.estimate(image, Camera.from_fov(width, height, guess.degrees))
    view = choose_field_of_view(arguments.hfov, depth.hfov_deg, arguments.trajectory)
    return depth, view, Camera.from_fov(width, height, view.degrees)


def _depth_beside(image: Path) -> str | None:
    """The depth file that belongs to an image by its name, if there is one."""
    for suffix in _DEPTH_SUFFIXES:
        candidate = image.with_name(image.stem + suffix)
        if candidate.is_file():
            return f"file:{candidate}"
    return None


def _facts(arguments: argparse.Namespace, depth: DepthEstimate, view: FieldOfView, radius: float) -> dict[str, object]:
    """What a reader of the result must know beside the configuration; kept in the scene and in config.json."""
    return {
        "image": arguments.image.name,
        "seed": arguments.seed,
        "device": arguments.device,
        "trajectory": arguments.trajectory,
        "hfov_deg": view.degrees,
        "hfov_source": view.source,
        "depth_source": depth.source,
        "depth_is_metric": depth.is_metric,
        "depth_notes": list(depth.notes),
        "unit": "R",
        "scene_radius": radius,
    }


def _reconstruct_answer(
    scene: Scene, record: dict[str, Any], seconds: dict[str, float], folder: Path, depth: DepthEstimate, holes: float
) -> Answer:
    names = (
        "scene.safetensors",
        "preview.mp4",
        "preview.png",
        "ledger.json",
        "ledger.png",
        "config.json",
        "timings.json",
    )
    files = [name for name in names if (folder / name).exists()]
    psnr = record["input_psnr"]
    document: dict[str, object] = {
        "anchors": scene.num_anchors,
        "anchors_by_stage": record["anchors"],
        "input_psnr": psnr,
        "holes": holes,
        "seconds": seconds,
        "provenance": scene.provenance,
        "files": {name: str(folder / name) for name in files},
    }
    stages = ", ".join(f"{count} {stage}" for stage, count in record["anchors"].items())
    lines = [
        f"anchors     {scene.num_anchors} ({stages})",
        f"input PSNR  {psnr['final']:.2f} dB",
        "seconds     " + ", ".join(f"{stage} {value:.1f}" for stage, value in seconds.items()),
        f"depth       {depth.source}" + ("" if depth.is_metric else ", not metric"),
        *(f"note        {note}" for note in depth.notes),
        "priors      " + ", ".join(f"{record['priors'][key]} ({key})" for key in ("outpainter", "inpainter", "depth")),
        *([f"holes       {holes:.1%} of the preview: its cameras look past the scene"] if holes > 0.01 else []),
        *([f"note        {record['priors']['outpainter_failed']}"] if "outpainter_failed" in record["priors"] else []),
        f"field of view {scene.camera.hfov_deg:.1f} degrees ({scene.provenance['hfov_source']})",
        *(f"wrote       {folder / name}" for name in files),
    ]
    return document, "\n".join(lines)


def _ends(
    record: dict[str, Any], ledger: dict[str, Any], config: ReconstructConfig, camera: Camera
) -> tuple[dict[str, object], list[str]]:
    """Why each stage made no more than it did, and how much of the canvas that is allowed was used."""
    trained = {
        phase: f"{run['stopped']} after {run['iterations']} iterations"
        for phase, run in record.get("history", {}).items()
    }
    solved = {"all": "solved in closed form, no gradient steps"}
    stopped = {"growth": record["growth"]["stopped"], "training": trained or solved, "repair": ledger["stopped"]}
    limit = config.canvas.max_scale
    most = [(limit - 1) / 2 * size for size in (camera.width, camera.height) * 2]  # each side has its own limit
    sides = ("left", "top", "right", "bottom")
    full = [side for side, margin, room in zip(sides, record["margins"], most, strict=True) if margin >= room > 0]
    width, height = record["canvas_scale"]
    lines = [
        f"growth      stopped at: {stopped['growth']}",
        "training    " + ", ".join(f"{phase}: {why}" for phase, why in stopped["training"].items()),
        f"repair      stopped at: {stopped['repair']}",
        f"canvas      {width:.2f} x {height:.2f} of the image's size, at most {limit:g}"
        + (f"; the path looks farther on the {' and '.join(full)}" if full else ""),
    ]
    canvas = {"scale": [width, height], "limit": limit, "margins": record["margins"], "sides_at_limit": full}
    return {"stopped": stopped, "canvas": canvas}, lines


def _write_json(path: Path, document: dict[str, Any]) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
