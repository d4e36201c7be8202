"""Data sets: scene cases with their cameras."""

from bench.datasets.case import Dataset, SceneCase, TrueView
from bench.datasets.catalogue import (
    DATASET_DESCRIPTIONS,
    DATASETS,
    DatasetOptions,
    open_dataset,
    resolve_data_root,
)

__all__ = [
    "DATASETS",
    "DATASET_DESCRIPTIONS",
    "Dataset",
    "DatasetOptions",
    "SceneCase",
    "TrueView",
    "open_dataset",
    "resolve_data_root",
]
