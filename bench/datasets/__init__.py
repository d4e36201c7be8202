"""Data sets: scene cases with their cameras."""

from bench.datasets.case import Dataset, SceneCase, TrueView

__all__ = ["Dataset", "SceneCase", "TrueView"]
