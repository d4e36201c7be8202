"""``bench list``: what there is, one line each."""

from __future__ import annotations

import argparse
from collections.abc import Callable

from bench.commands.outcome import Outcome

__all__ = ["METHOD_DESCRIPTIONS", "METRIC_DESCRIPTIONS", "list_command"]

METHOD_DESCRIPTIONS = {
    "orca": "ORCA with metric lifting: distances proportional to the depth it is given",
    "orca-paper": "ORCA with the paper's relative lifting, placed on the path by the median depth ratio",
    "orca-norepair": "ORCA without repair: disocclusions stay open",
    "orca-plainfill": "ORCA with the paper's plain local fill",
    "vistadream": "VistaDream's published videos after refinement, decoded (realmdreamer only)",
    "vistadream-coarse": "VistaDream's published videos before refinement, decoded (realmdreamer only)",
    "warp": "the input, forward-warped with the reference depth; holes stay black",
    "warp-telea": "the same, holes filled by Telea inpainting frame by frame",
    "warp-nearest": "the same, holes filled with the nearest pixel frame by frame",
}

METRIC_DESCRIPTIONS = {
    "tsed": "share of consecutive frame pairs whose median symmetric epipolar distance is under 2 px",
    "tsed_median_sed": "median symmetric epipolar distance of consecutive frames, px",
    "psnr": "PSNR against a real second view, dB",
    "ssim": "SSIM against a real second view",
    "hole_psnr": "PSNR against a real second view where the input shows nothing, dB",
    "hole_ssim": "SSIM against a real second view where the input shows nothing",
    "lpips": "LPIPS (AlexNet) against a real second view; needs weights",
    "hole_lpips": "LPIPS (AlexNet) against a real second view where the input shows nothing; needs weights",
    "hidden_depth": "share of filled pixels that lie nearer to what was hidden than to what hid it (synthetic only)",
    "input_psnr": "PSNR of the input view, dB",
    "hole_fraction": "share of pixels that the method leaves empty",
    "visible_psnr": "PSNR of novel views where their content is visible in the input, dB",
    "flicker": "colour change of the input's points between consecutive frames, by the reference depth, 0..255",
    "flicker_own_depth": "colour change of all points between consecutive frames, by the method's own depth, 0..255",
    "niqe": "NIQE, no reference; needs the prior in --weights-dir",
    "musiq": "MUSIQ, no reference; needs weights",
    "clipiqa": "CLIP-IQA, no reference; needs weights",
    "clipiqa_openclip": "CLIP-IQA by open_clip, without pyiqa, the same prompts; needs weights; on request",
    "clipiqa_photo": "CLIP-IQA with the one pair 'Good photo.', 'Bad photo.'; needs weights; on request",
    "llava_noise_free": "LLaVA-IQA: share of frames free of noise or distortion",
    "llava_edge": "LLaVA-IQA: share of frames with clear objects and sharp edges",
    "llava_structure": "LLaVA-IQA: share of frames with a coherent layout",
    "llava_detail": "LLaVA-IQA: share of frames with detailed textures",
    "llava_quality": "LLaVA-IQA: share of frames of high overall quality",
    "lpips_vgg": "LPIPS (VGG-16) against a real second view; needs weights; on request",
    "hole_lpips_vgg": "the same where the input shows nothing; on request",
    "epipolar_self_consistency": "TSED with geometry estimated from the frames: blind to wrong cameras; on request",
    "epipolar_self_consistency_median_sed": "median distance to the estimated geometry, px; on request",
}


def list_command(args: argparse.Namespace) -> Outcome:
    """Names and one-line descriptions of a kind of thing; the scenes of a data set are named without one.

    Raises `Unavailable` for the scenes of a data set whose files are not here.
    """
    listings: dict[str, Callable[[], dict[str, str]]] = {
        "datasets": _datasets,
        "methods": _methods,
        "points": _points,
        "metrics": _metrics,
        "trajectories": _trajectories,
        "scenes": lambda: _scenes(args),
    }
    found = listings[args.what]()
    width = max((len(name) for name in found), default=0)
    text = "\n".join(f"{name.ljust(width)}  {line}".rstrip() for name, line in found.items())
    items = [{"name": name, "description": line} for name, line in found.items()]
    return Outcome(text + "\n", {"schema_version": 1, args.what: items})


def _datasets() -> dict[str, str]:
    from bench.datasets import DATASET_DESCRIPTIONS, DATASETS

    return {name: DATASET_DESCRIPTIONS.get(name, "") for name in DATASETS}


def _methods() -> dict[str, str]:
    from bench.adapters import METHODS

    return {name: METHOD_DESCRIPTIONS.get(name, "") for name in METHODS}


def _points() -> dict[str, str]:
    from bench.adapters.points import KNOBS, SWEEP

    keys = {f"orca@{key}=": f"{knob.what}: {knob.allowed}" for key, knob in KNOBS.items()}
    return keys | {name: "in the default sweep" for name in SWEEP if "@" in name}


def _metrics() -> dict[str, str]:
    from bench.metrics import METRICS

    return {name: METRIC_DESCRIPTIONS.get(name, "") for name in METRICS}


def _trajectories() -> dict[str, str]:
    from bench.trajectories import list_trajectories

    return list_trajectories()


def _scenes(args: argparse.Namespace) -> dict[str, str]:
    from bench.datasets import open_dataset

    dataset = open_dataset(args.dataset, data_root=args.data_root, images=args.images)
    return dict.fromkeys(dataset.scenes(), "")
