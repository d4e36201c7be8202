"""Camera paths: hashed data that belong to the data set, never to a method."""

from bench.trajectories.generate import (
    EVAL_FRAMES,
    build_trajectory,
    evenly_spaced,
    first_difference,
    from_poses,
    list_trajectories,
    load_trajectory,
    save_trajectory,
)
from bench.trajectories.trajectory import Trajectory

__all__ = [
    "EVAL_FRAMES",
    "Trajectory",
    "build_trajectory",
    "evenly_spaced",
    "first_difference",
    "from_poses",
    "list_trajectories",
    "load_trajectory",
    "save_trajectory",
]
