"""What the verbs `export` and `view` do: neural scenes as plain splats, in a file or in a browser."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from orca.camera import Camera
from orca.commands import Answer
from orca.paths import PATHS
from orca.placement import path_in_scene_radii
from orca.progress import PhaseBars
from orca.scene import Scene
from orca.splats.agreement import agreement, held_out
from orca.splats.bake import BakeConfig, anchor_splats, bake, fitted_frames
from orca.splats.model import Splats
from orca.splats.split import stages

__all__ = ["export", "view"]

_VIEWER_SIGMA = 0.5  # px: viser does not draw what is much narrower (measured: 28.0 dB of the neural render, else 25.7)


def export(arguments: argparse.Namespace) -> Answer:
    """Scene in, splat file out; how well it agrees with the neural scene, and a page, if asked for."""
    from orca.export import read_splats, write_splats

    scene = Scene.load(arguments.scene)
    path, config = _path(arguments, scene), _config(arguments)
    with PhaseBars() as bars:
        splats = bake(scene, path, config, bars)
    count = write_splats(splats, arguments.ply)
    size = arguments.ply.stat().st_size
    counts = {"splats": count, "anchors": scene.num_anchors, "bytes": size}
    document: dict[str, object] = {"ply": str(arguments.ply), **counts}
    lines = [f"{arguments.ply}: {count} splats of {scene.num_anchors} anchors, {size} bytes"]
    if arguments.psnr:
        # From the file, so that what is reported is what a viewer gets.
        written = read_splats(arguments.ply)
        psnr = _agreement(scene, written, path, fitted_frames(len(path), config))
        document["psnr"] = psnr
        lines.append(f"agreement with the neural render: {psnr['input']:.2f} dB at the input view")
        if "held_out" in psnr:
            lines[-1] += f", {psnr['held_out']:.2f} dB on views of the path that were not fitted"
    if arguments.html is not None:
        from orca.view import write_html

        document |= {"html": str(arguments.html), "html_bytes": write_html(splats, scene.camera, arguments.html)}
        lines.append(f"{arguments.html}: {document['html_bytes']} bytes, a page for browsers (see --help: serve it)")
    return document, "\n".join(lines)


def view(arguments: argparse.Namespace, announce: Callable[[str], None]) -> Answer:
    """Serve a scene to a browser until Ctrl-C; ``announce`` is told the address once it is up."""
    from orca.export import read_splats
    from orca.view import SceneViewer

    scene = Scene.load(arguments.scene)
    path = _path(arguments, scene)
    if arguments.ply is not None:
        splats = stages(read_splats(arguments.ply), anchor_splats(scene))
    else:
        with PhaseBars() as bars:
            # A viewer that does not draw what is small has no use for halves.
            splats = bake(scene, path, replace(_config(arguments), min_sigma=_VIEWER_SIGMA, rounds=0), bars)
    server = SceneViewer(splats, scene.camera, path, arguments.host, arguments.port)
    # Ctrl-C is the way to end it, also for somebody who is told and does so at once.
    with server as viewer, contextlib.suppress(KeyboardInterrupt):
        announce(f"{viewer.url} shows {len(splats)} splats; Ctrl-C ends it")
        viewer.wait()
    return {"url": viewer.url, "splats": len(splats)}, "closed"


def _config(arguments: argparse.Namespace) -> BakeConfig:
    given = {"steps": arguments.steps, "target_psnr": getattr(arguments, "target_psnr", None)}
    return replace(BakeConfig(), **{name: value for name, value in given.items() if value is not None})


def _path(arguments: argparse.Namespace, scene: Scene) -> tuple[Camera, ...]:
    """The path asked for, else the one that the scene was made for, else a spiral."""
    own = scene.provenance.get("trajectory")
    name = arguments.trajectory or (own if own in PATHS else "spiral")
    return path_in_scene_radii(name, None, scene.camera, float(scene.provenance.get("scene_radius", 1.0)))


def _agreement(scene: Scene, splats: Splats, path: Sequence[Camera], fitted: Sequence[int]) -> dict[str, float]:
    first, *others = agreement(scene, splats, (scene.camera, *(path[i] for i in held_out(path, fitted, scene.camera))))
    return {"input": first, **({"held_out": float(np.mean(others))} if others else {})}
