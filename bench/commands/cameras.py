"""``bench cameras``: what another method needs to render along the same cameras."""

from __future__ import annotations

import argparse

from bench.commands.names import chosen
from bench.commands.outcome import Outcome
from bench.datasets import open_dataset
from bench.trajectories import save_trajectory
from orca.images import save_image

__all__ = ["cameras_command"]


def cameras_command(args: argparse.Namespace) -> Outcome:
    """Write ``DIR/<scene>/cameras.json`` and ``DIR/<scene>.png``, the input image, for each scene.

    Frames rendered along those cameras, laid beside the camera file, are what ``run --methods frames:DIR`` reads.

    Raises:
        Unknown: no such data set, scene or trajectory.
        Unavailable: the data are not here.
    """
    dataset = open_dataset(args.dataset, data_root=args.data_root, images=args.images, trajectory=args.trajectory)
    known = dataset.scenes()
    lines, entries = [], []
    for scene in chosen("scene", args.scenes, known, known):
        case = dataset.load(scene)
        file = args.out / scene / "cameras.json"
        save_trajectory(case.trajectory, file)
        save_image(args.out / f"{scene}.png", case.image)
        lines.append(f"{file}: {len(case.trajectory)} cameras, '{case.trajectory.name}', unit {case.trajectory.unit}")
        entries.append(
            {
                "scene": scene,
                "file": str(file),
                "cameras": len(case.trajectory),
                "trajectory_sha256": case.trajectory.sha256,
                "evaluated": list(case.eval_indices),
            }
        )
    lines.append(
        "World = input view: x right, y down, z forward (OpenCV), pixel centres at 0.5, lengths in scene radii. "
        "Render every camera, or the evaluated ones, into the scene's folder."
    )
    return Outcome("\n".join(lines), {"schema_version": 1, "scenes": entries})
