"""Procedural scenes with exact depth, exact novel views and exact masks of what the input did not see.

Each of 20 seeds is one geometry with two sets of textures: ``predictable-07`` continues under an occluder as it began
(gradients, stripes, tiles), ``unpredictable-07`` does not (noise, patches, blobs). Four frames of the path are true
views. Their ``hidden`` pixels show points inside the input's frame that something hid; what lies outside the frame is
a question of outpainting and is not among them. No files, no data root: a scene is made in under a second.

The same from 20 other seeds is ``synthetic-unseen``: no constant of ORCA was chosen by looking at those.
"""

from __future__ import annotations

from collections.abc import Sequence

from bench.datasets.assemble import DEFAULT_HFOV_DEG, check_scene, in_scene_radii
from bench.datasets.case import Dataset, SceneCase, TrueView
from bench.datasets.catalogue import DatasetOptions
from bench.datasets.synthetic_scene import Surfaces, hidden_from, random_scene, render_colour, render_depth
from bench.datasets.synthetic_textures import PREDICTABLE, UNPREDICTABLE
from bench.trajectories import build_trajectory, evenly_spaced
from orca.camera import Camera
from orca.conventions import Float64Array
from orca.errors import BadInput

__all__ = ["SEEDS", "Synthetic", "open_synthetic", "open_unseen"]

SEEDS = 20
FIRST_UNSEEN = 100
SIZE = 256
FRAMES = 13
TRUE_VIEWS = 4
DEFAULT_PATH = "swing"

_TEXTURES = {"predictable": PREDICTABLE, "unpredictable": UNPREDICTABLE}


def open_synthetic(options: DatasetOptions) -> Dataset:
    """The factory of the registry."""
    return Synthetic(options.trajectory or DEFAULT_PATH)


def open_unseen(options: DatasetOptions) -> Dataset:
    """The factory of the scenes that nothing was tuned on."""
    return Synthetic(options.trajectory or DEFAULT_PATH, first_seed=FIRST_UNSEEN)


class Synthetic:
    """``predictable-00`` to ``-19`` and ``unpredictable-00`` to ``-19``, 256x256 unless told otherwise.

    With another first seed: 20 scenes of each kind from there on.
    """

    def __init__(self, trajectory: str = DEFAULT_PATH, size: int = SIZE, first_seed: int = 0) -> None:
        if size < 16:
            raise BadInput(f"synthetic scenes of {size} pixels a side", "at least 16", "ask for a larger image")
        self._trajectory, self._size = trajectory, size
        self._seeds = range(first_seed, first_seed + SEEDS)
        self.name = "synthetic" if first_seed == 0 else "synthetic-unseen"

    def scenes(self) -> Sequence[str]:
        """Scene names, the predictable ones first."""
        return tuple(f"{kind}-{seed:02d}" for kind in _TEXTURES for seed in self._seeds)

    def load(self, scene: str) -> SceneCase:
        """Make one scene. Raises `Unknown` for a wrong name."""
        kind, seed = check_scene(scene, self.scenes(), self.name).split("-")
        surfaces = random_scene(int(seed), _TEXTURES[kind])
        camera = Camera.from_fov(self._size, self._size, DEFAULT_HFOV_DEG)
        depth, radius = in_scene_radii(render_depth(surfaces, camera), camera)
        frames = None if self._trajectory.endswith(".json") else FRAMES
        trajectory = build_trajectory(self._trajectory, camera, frames)
        chosen = evenly_spaced(len(trajectory), TRUE_VIEWS + 2)[1:-1]
        return SceneCase(
            dataset=self.name,
            name=scene,
            image=render_colour(surfaces, camera),
            camera=camera,
            depth=depth,
            depth_source="exact",
            depth_is_metric=True,
            depth_is_measured=True,
            fov_source="exact",
            trajectory=trajectory,
            eval_indices=evenly_spaced(len(trajectory)),
            true_views=tuple(_true_view(surfaces, camera, trajectory.camera(i), radius) for i in chosen),
        )


def _true_view(surfaces: Surfaces, source: Camera, view: Camera, radius: float) -> TrueView:
    """The exact view at a camera whose pose is in scene radii; the surfaces are in units of their own."""
    moved = Camera(view.K, _with_translation(view.world_to_camera, radius), view.width, view.height)
    hidden = hidden_from(surfaces, source, moved)
    return TrueView(
        camera=view,
        image=render_colour(surfaces, moved),
        hidden=hidden.occluded,
        depth=render_depth(surfaces, moved) / radius,
        occluder_depth=hidden.occluder_depth / radius,
    )


def _with_translation(pose: Float64Array, scale: float) -> Float64Array:
    scaled = pose.copy()
    scaled[:3, 3] *= scale
    return scaled
