"""Neural Gaussian anchors: N(mu, Sigma), an opacity logit and a latent feature each (paper Eq. 1, METHOD.md 1)."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from enum import IntEnum
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from orca.conventions import Float64Array
from orca.errors import BadInput

__all__ = ["FEATURE_DIM", "GaussianAnchors", "Stage", "quaternions_to_rotations", "rotations_to_quaternions"]

FEATURE_DIM = 32


class Stage(IntEnum):
    """What an anchor was made from."""

    ORIGINAL = 0
    OUTPAINTED = 1
    REPAIRED = 2


def quaternions_to_rotations(quaternions: Tensor) -> Tensor:
    """Rotation matrices [N, 3, 3] of wxyz quaternions [N, 4], which are normalised first."""
    unit = F.normalize(quaternions, dim=-1)
    products = (unit[:, :, None] * unit[:, None, :]).flatten(1)  # one matrix product instead of forty small ones
    identity = torch.eye(3, dtype=unit.dtype, device=unit.device)
    return (products @ torch.from_numpy(_rotation_of_products()).to(unit)).view(-1, 3, 3) + identity


@lru_cache(maxsize=1)
def _rotation_of_products() -> Float64Array:
    """What the products q_i q_j of a unit quaternion wxyz add to the identity, [16, 9]."""
    w, x, y, z = range(4)
    entries = [
        [(-2, y, y), (-2, z, z)],
        [(2, x, y), (-2, w, z)],
        [(2, x, z), (2, w, y)],
        [(2, x, y), (2, w, z)],
        [(-2, x, x), (-2, z, z)],
        [(2, y, z), (-2, w, x)],
        [(2, x, z), (-2, w, y)],
        [(2, y, z), (2, w, x)],
        [(-2, x, x), (-2, y, y)],
    ]
    table = np.zeros((16, 9))
    for column, terms in enumerate(entries):
        for factor, i, j in terms:
            table[4 * i + j, column] += factor
    return table


def rotations_to_quaternions(rotations: Tensor) -> Tensor:
    """Quaternions wxyz [N, 4] of proper rotation matrices [N, 3, 3] (Shepperd: the largest component first)."""
    m = rotations
    trace = m[:, 0, 0] + m[:, 1, 1] + m[:, 2, 2]
    squares = torch.stack(
        [trace, m[:, 0, 0], m[:, 1, 1], m[:, 2, 2]],
        dim=-1,
    )
    squares = 1 + torch.cat([squares[:, :1], 2 * squares[:, 1:] - trace[:, None]], dim=-1)
    yz, zx, xy = m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]
    sxy, szx, syz = m[:, 1, 0] + m[:, 0, 1], m[:, 0, 2] + m[:, 2, 0], m[:, 2, 1] + m[:, 1, 2]
    candidates = torch.stack(
        [
            torch.stack([squares[:, 0], yz, zx, xy], -1),
            torch.stack([yz, squares[:, 1], sxy, szx], -1),
            torch.stack([zx, sxy, squares[:, 2], syz], -1),
            torch.stack([xy, szx, syz, squares[:, 3]], -1),
        ],
        dim=1,
    )  # [N, 4, 4], each row a multiple of the quaternion
    best = squares.argmax(-1)
    return F.normalize(candidates[torch.arange(len(m), device=m.device), best], dim=-1)


@dataclass(frozen=True, eq=False)
class GaussianAnchors:
    """N anchors as tensors on one device.

    Attributes:
        means: centres mu in world units, [N, 3] float32.
        log_variances: logarithms of the variances along the principal axes, [N, 3] float32.
        quaternions: orientation, wxyz, normalised on use, [N, 4] float32.
        opacity_logits: omega; opacity is sigmoid(omega), [N] float32.
        features: latent features f, [N, 32] float32 (at inference a buffer; METHOD.md 1).
        stage: which `Stage` made the anchor, [N] uint8.
    """

    means: Tensor
    log_variances: Tensor
    quaternions: Tensor
    opacity_logits: Tensor
    features: Tensor
    stage: Tensor

    def __post_init__(self) -> None:
        n = len(self.means)
        expected = {
            "means": (n, 3),
            "log_variances": (n, 3),
            "quaternions": (n, 4),
            "opacity_logits": (n,),
            "features": (n, FEATURE_DIM),
            "stage": (n,),
        }
        for name, shape in expected.items():
            given = tuple(getattr(self, name).shape)
            if given != shape:
                raise BadInput(f"anchors with {name} of shape {given}", f"{shape}", "check the scene file")

    def __len__(self) -> int:
        return len(self.means)

    def rotations(self) -> Tensor:
        """Principal axes as columns, [N, 3, 3]."""
        return quaternions_to_rotations(self.quaternions)

    def whitening(self) -> Tensor:
        """A = diag(1/s) R^T, [N, 3, 3]: maps the anchor's ellipsoid to the unit sphere."""
        return torch.exp(-0.5 * self.log_variances)[:, :, None] * self.rotations().transpose(1, 2)

    def covariances(self) -> Tensor:
        """Sigma = R diag(exp(log_variances)) R^T, [N, 3, 3]."""
        axes = self.rotations() * torch.exp(0.5 * self.log_variances)[:, None, :]
        return axes @ axes.transpose(1, 2)

    def subset(self, keep: Tensor) -> GaussianAnchors:
        """The anchors that an index or a mask selects."""
        return GaussianAnchors(**{f.name: getattr(self, f.name)[keep] for f in fields(self)})

    def detached(self) -> GaussianAnchors:
        """The same values without a graph."""
        return GaussianAnchors(**{f.name: getattr(self, f.name).detach() for f in fields(self)})

    def to(self, device: str | torch.device) -> GaussianAnchors:
        """The same anchors on another device."""
        return GaussianAnchors(**{f.name: getattr(self, f.name).to(device) for f in fields(self)})

    def with_features(self, features: Tensor) -> GaussianAnchors:
        """The same geometry carrying other features."""
        return replace(self, features=features)

    @staticmethod
    def concatenate(*parts: GaussianAnchors) -> GaussianAnchors:
        """All anchors of several sets, in order."""
        return GaussianAnchors(**{f.name: torch.cat([getattr(p, f.name) for p in parts]) for f in fields(parts[0])})
