"""NIQE (Mittal, Soundararajan and Bovik, "Making a completely blind image quality analyzer", 2013) in numpy.

The same definition as pyiqa's ``niqe`` (rounded Y of YIQ, blocks of 96 px, two scales), an order of magnitude faster on
a CPU: pyiqa's double-precision convolutions and table look-ups take 0.3 s for a frame of 512x512. A test holds the two
together.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from bench.metrics.matlab_file import read_matrices
from orca.conventions import Float64Array, UInt8Array
from orca.errors import BadInput

__all__ = ["BLOCK", "NiqePrior", "niqe"]

BLOCK = 96
FEATURES = 36  # 18 a scale
_MEAN, _COVARIANCE = "mu_prisparam", "cov_prisparam"
LUMA = np.array([0.299, 0.587, 0.114], np.float32)
# Neighbours whose products with a pixel are modelled: (rows, columns), cyclic inside a block.
SHIFTS = ((0, 1), (1, 0), (1, 1), (1, -1))


@dataclass(frozen=True, eq=False)
class NiqePrior:
    """The Gaussian of pristine photographs' features.

    Attributes:
        mean: [36] float64.
        covariance: [36, 36] float64.
    """

    mean: Float64Array
    covariance: Float64Array

    @staticmethod
    def read(path: Path) -> NiqePrior:
        """Read a MATLAB file with ``mu_prisparam`` and ``cov_prisparam``; raises `BadInput` for anything else."""
        found = read_matrices(path, (_MEAN, _COVARIANCE))
        if len(found) != 2:
            raise _broken(path, f"only {', '.join(found) or 'neither'} of the two in it")
        mean, covariance = found[_MEAN].ravel(), found[_COVARIANCE]
        if mean.shape != (FEATURES,) or covariance.shape != (FEATURES, FEATURES):
            raise _broken(path, f"mean {mean.shape}, covariance {covariance.shape}")
        return NiqePrior(mean, covariance)


def niqe(frame: UInt8Array, prior: NiqePrior) -> float | None:
    """Distance of a frame's block statistics from the prior; lower is better.

    Args:
        frame: [H, W, 3] uint8.
        prior: the Gaussian of pristine photographs.

    Returns:
        The distance, or None when there are fewer than two whole blocks or all of them are flat.
    """
    rows, columns = frame.shape[0] // BLOCK, frame.shape[1] // BLOCK
    if rows * columns < 2:
        return None
    luma = np.rint((frame[: rows * BLOCK, : columns * BLOCK] / np.float32(255)) @ LUMA * np.float32(255))
    full = luma.astype(np.float64)
    features = np.hstack([_features(_normalised(full), BLOCK), _features(_normalised(_halved(full)), BLOCK // 2)])
    complete = features[~np.isnan(features).any(axis=1)]
    if len(complete) == 0:
        return None
    covariance = np.cov(complete, rowvar=False, ddof=min(1, len(complete) - 1))
    # The mean takes every value that is there, also from blocks that are flat at one scale only.
    difference = prior.mean - np.nanmean(features, axis=0)
    precision = np.linalg.pinv((prior.covariance + covariance) / 2, rcond=FEATURES * np.finfo(np.float64).eps)
    return float(np.sqrt(difference @ precision @ difference))


def _normalised(luma: Float64Array) -> Float64Array:
    """Mean-subtracted, contrast-normalised coefficients: 7x7 Gaussian of sigma 7/6, edges repeated."""
    side = cv2.getGaussianKernel(7, 7 / 6, cv2.CV_64F)
    # pyiqa rounds the kernel to float32. In flat regions that rounding alone sets the sign of the coefficients, and
    # the features count signs: without it, scores of frames with black holes differ by up to 0.06.
    kernel = (side @ side.T).astype(np.float32).astype(np.float64)
    mean = cv2.filter2D(luma, cv2.CV_64F, kernel, borderType=cv2.BORDER_REPLICATE)
    square = cv2.filter2D(luma**2, cv2.CV_64F, kernel, borderType=cv2.BORDER_REPLICATE)
    deviation = np.sqrt(np.abs(square - mean**2) + np.finfo(np.float64).eps)
    return np.asarray((luma - mean) / (deviation + 1.0))


def _halved(luma: Float64Array) -> Float64Array:
    """Half the size by bicubic interpolation (a = -1/2) stretched over 8 pixels, as MATLAB's imresize does."""
    distance = np.abs(np.arange(-3, 5) - 0.5) / 2
    inner = 1.5 * distance**3 - 2.5 * distance**2 + 1
    outer = -0.5 * distance**3 + 2.5 * distance**2 - 4 * distance + 2
    kernel = np.where(distance <= 1, inner, outer)
    kernel /= kernel.sum()
    smooth = cv2.sepFilter2D(luma, cv2.CV_64F, kernel, kernel, anchor=(3, 3), borderType=cv2.BORDER_REFLECT)
    return np.asarray(smooth[::2, ::2])


def _features(coefficients: Float64Array, block: int) -> Float64Array:
    """18 features of each block, [blocks, 18]: the coefficients' own distribution, and those of four products."""
    rows, columns = coefficients.shape[0] // block, coefficients.shape[1] // block
    split = coefficients.reshape(rows, block, columns, block).swapaxes(1, 2)
    blocks = np.ascontiguousarray(split).reshape(rows * columns, block, block)
    shape, left, right = _fit(blocks)
    found = [shape, (left + right) / 2]
    for shift in SHIFTS:
        shape, left, right = _fit(blocks * np.roll(blocks, shift, axis=(1, 2)))
        found += [shape, (right - left) * _gamma_ratio(2.0, 1.0, shape), left, right]
    return np.stack(found, axis=1)


def _fit(blocks: Float64Array) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Asymmetric generalised Gaussian of each block by moment matching: shape, left scale, right scale, [blocks]."""
    flat = blocks.reshape(len(blocks), -1)
    negative = np.minimum(flat, 0.0)
    squares, left_squares = np.einsum("bn,bn->b", flat, flat), np.einsum("bn,bn->b", negative, negative)
    absolute = flat.sum(axis=1) - 2 * negative.sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):  # a flat block has no moments: NaN, by design
        left = np.sqrt(left_squares / (flat < 0).sum(axis=1))
        right = np.sqrt((squares - left_squares) / (flat > 0).sum(axis=1))
        ratio = left / right
        moment = absolute**2 / (squares * flat.shape[1])
        target = moment * (ratio**3 + 1) * (ratio + 1) / (ratio**2 + 1) ** 2
    shape = _shape_of(target)
    scale = np.sqrt(_gamma_ratio(1.0, 3.0, shape))
    return shape, left * scale, right * scale


def _shape_of(target: Float64Array) -> Float64Array:
    """The shape in 0.2, 0.201 ... 10 whose moment ratio is nearest to the target; 0.2 where there is none."""
    shapes, moments = _shape_table()
    above = np.clip(np.searchsorted(moments, target), 1, len(shapes) - 1)
    nearest = np.where(target - moments[above - 1] <= moments[above] - target, above - 1, above)
    return np.asarray(np.where(np.isnan(target), shapes[0], shapes[nearest]))


@lru_cache(maxsize=1)
def _shape_table() -> tuple[Float64Array, Float64Array]:
    """Shapes and their moment ratios E|x|^2 / E x^2, which grow with the shape."""
    shapes = np.arange(200, 10001) / 1000
    return shapes, _gamma_ratio(2.0, 1.0, shapes) * _gamma_ratio(2.0, 3.0, shapes)


def _gamma_ratio(a: float, b: float, shape: Float64Array) -> Float64Array:
    """Gamma(a / shape) / Gamma(b / shape)."""
    from scipy.special import gammaln

    return np.asarray(np.exp(gammaln(a / shape) - gammaln(b / shape)))


def _broken(path: Path, why: str) -> BadInput:
    return BadInput(
        f"the NIQE prior {path} cannot be read ({why})",
        f"a MATLAB file with mu_prisparam [{FEATURES}] and cov_prisparam [{FEATURES}, {FEATURES}]",
        "get niqe_modelparameters.mat again (BasicSR or pyiqa publish it)",
    )
