"""From a filled RGB-D target to new anchors, in front of nothing and behind the foreground (paper Sec. 3.3)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from orca.anchors import FEATURE_DIM, GaussianAnchors, Stage
from orca.camera import Camera
from orca.conventions import Float32Array
from orca.field.decoders import COLOUR_CHANNELS, DENSITY_CHANNEL, Decoders
from orca.repair.rules import RepairRules
from orca.repair.spacing import TargetCells

__all__ = ["InsertConfig", "features_for_colours", "new_anchors"]


@dataclass(frozen=True)
class InsertConfig:
    """How wide new anchors are, and how colours become features.

    Attributes:
        kappa: standard deviation over spacing before the covariance multiplier (that of the planar grid).
        colour_clip: colours are kept this far from 0 and 1.
        tolerance: the largest colour error at which the analytic inverse of the decoders counts as exact.
        cell_error: squared colour error that one anchor may leave of a repair's target, summed over pixels and
            channels; 0 gives every pixel its own (`RepairConfig.spread`).
    """

    kappa: float = 0.5
    colour_clip: float = 2e-3
    tolerance: float = 4e-3
    cell_error: float = 0.0


def new_anchors(
    cells: TargetCells,
    camera: Camera,
    existing: GaussianAnchors,
    decoders: Decoders,
    rules: RepairRules,
    config: InsertConfig,
) -> GaussianAnchors:
    """One anchor for each cell of a repair's target.

    Args:
        cells: where, how large, colour and depth.
        camera: the view they are seen in.
        existing: the scene's anchors; only read, for features under decoders that have no analytic inverse.
        decoders: the scene's decoders.
        rules: covariance multiplier, opacity.
        config: extents and colour handling.
    """
    means = camera.unproject(cells.centres, cells.depth)
    sigma = config.kappa * cells.sides * cells.depth / camera.K[0, 0]
    log_variance = 2 * np.log(sigma) + math.log(rules.covariance_scale)
    n = len(means)
    identity = torch.zeros(n, 4)
    identity[:, 0] = 1.0
    opacity = math.log(rules.min_opacity / (1 - rules.min_opacity)) if rules.min_opacity < 1 else 10.0
    return GaussianAnchors(
        means=torch.from_numpy(means.astype(np.float32)),
        log_variances=torch.from_numpy(np.repeat(log_variance[:, None], 3, 1).astype(np.float32)),
        quaternions=identity,
        # A hair above the minimum, so that rounding cannot take it below.
        opacity_logits=torch.full((n,), opacity + 1e-4),
        features=features_for_colours(cells.rgb, existing, decoders, config),
        stage=torch.full((n,), int(Stage.REPAIRED), dtype=torch.uint8),
    )


def features_for_colours(
    rgb: Float32Array, existing: GaussianAnchors, decoders: Decoders, config: InsertConfig
) -> Tensor:
    """Features [n, 32] that decode to the colours [n, 3].

    With analytic decoders (METHOD.md 1.2) colour logits are features: the inverse is exact and is checked. Decoders
    trained from random weights have no inverse: each colour takes the features of the existing anchor that decodes
    nearest to it, and the optimisation that follows does the rest.
    """
    clipped = np.clip(rgb, config.colour_clip, 1 - config.colour_clip)
    features = torch.zeros(len(rgb), FEATURE_DIM)
    features[:, :COLOUR_CHANNELS] = torch.from_numpy(np.log(clipped / (1 - clipped)).astype(np.float32))
    features[:, DENSITY_CHANNEL] = 1.0
    if len(rgb) == 0:  # all of a repair may lie where the input would see it
        return features
    with torch.inference_mode():
        density, decoded = decoders(features)
        exact = float((decoded - torch.from_numpy(clipped)).abs().max()) <= config.tolerance and bool(
            (density > 1).all()
        )
        if exact:
            return features
        from scipy.spatial import cKDTree

        _, colours = decoders(existing.features)
    nearest = cKDTree(colours.numpy()).query(rgb)[1]
    return existing.features[torch.from_numpy(np.asarray(nearest))].clone()
