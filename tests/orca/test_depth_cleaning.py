"""Estimated depth is cleaned before anchors follow it; measured depth is not."""

from __future__ import annotations

import numpy as np

from orca.config import get_preset
from orca.stages.deform import denoise_depth


def test_speckle_goes_and_edges_stay() -> None:
    rng = np.random.default_rng(0)
    clean = np.where(np.arange(64)[None, :] < 32, 1.0, 2.0) * np.ones((64, 1))
    noisy = clean * np.exp(rng.normal(0, 0.02, clean.shape))
    speckled = noisy.copy()
    speckled[rng.random(clean.shape) < 0.02] *= 1.3
    cleaned = denoise_depth(speckled.astype(np.float32))
    error = np.abs(np.log(cleaned / clean))
    assert error.mean() < 0.35 * np.abs(np.log(speckled / clean)).mean()
    assert np.abs(cleaned[:, 29:31] - 1.0).max() < 0.1  # the step is where it was
    assert np.abs(cleaned[:, 33:35] - 2.0).max() < 0.2


def test_constant_depth_is_untouched() -> None:
    depth = np.full((20, 30), 1.7, np.float32)
    assert np.allclose(denoise_depth(depth), depth, rtol=1e-6)


def test_measured_depth_is_trusted() -> None:
    config = get_preset("draft")
    assert config.deform.denoise_depth
    assert config.deform.sharpen_depth
    trusting = config.trusting_depth()
    assert not trusting.deform.denoise_depth
    assert not trusting.deform.sharpen_depth
    assert trusting.planar == config.planar
