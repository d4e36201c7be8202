"""Camera paths: hashed data that belong to the data set, never to a method."""

from bench.trajectories.trajectory import Trajectory

__all__ = ["Trajectory"]
