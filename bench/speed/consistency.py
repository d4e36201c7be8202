"""TSED's speed: frames of a rendered scene scored by the metric, which detects once, and by naive OpenCV, in turns."""

from __future__ import annotations

from statistics import median

import numpy as np

from bench.metrics.tsed_speed import TsedSpeed, measure_tsed_speed
from bench.speed.case import ANCHORS
from bench.speed.workshop import Workshop
from orca.conventions import to_uint8
from orca.render.surroundings import as_shown

__all__ = ["measure_consistency", "tsed_line"]

FRAMES = 50


def measure_consistency(
    workshop: Workshop, threads: int, repeats: int, frames: int = FRAMES, anchors: int = ANCHORS[0]
) -> TsedSpeed:
    """Render frames of the workshop's scene along its path, and score them both ways."""
    scene, width = workshop.scene(anchors, "layered"), workshop.base_width
    views = workshop.inputs(width).views
    chosen = [views[i] for i in np.linspace(0, len(views) - 1, frames).round().astype(int)]
    renderer = scene.renderer()
    pictures = np.stack([to_uint8(as_shown(renderer.render(view), scene.render_config).rgb) for view in chosen])
    return measure_tsed_speed(pictures, chosen, threads=threads, repeats=repeats)


def tsed_line(speed: TsedSpeed) -> str:
    """The comparison in one line, for people."""
    cpu = median(slow / fast for slow, fast in zip(speed.naive_cpu_seconds, speed.cpu_seconds, strict=True))
    verdicts = f"{speed.differing_pairs} pairs differ" if speed.differing_pairs else "all verdicts the same"
    return (
        f"TSED, {speed.frames} frames of {speed.width}x{speed.height}, {speed.threads} thread(s): "
        f"{median(speed.seconds):.2f} s; naive OpenCV (both frames of every pair detected anew, brute force both ways) "
        f"{median(speed.naive_seconds):.2f} s: {speed.ratio:.1f}x (CPU {cpu:.1f}x), {verdicts}"
    )
