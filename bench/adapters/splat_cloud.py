"""3D Gaussian splats with view-dependent colour, as other methods store them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from orca.conventions import Float32Array, Float64Array
from orca.errors import BadInput

__all__ = ["MAX_SPLATS", "SH_C0", "SplatCloud", "sh_basis"]

MAX_SPLATS = 20_000_000
SH_C0 = 0.5 / math.sqrt(math.pi)
_C1 = math.sqrt(3 / (4 * math.pi))
_C2 = math.sqrt(15 / (4 * math.pi))


@dataclass(frozen=True, eq=False)
class SplatCloud:
    """N splats in their own world: OpenCV axes where nothing else is said, any unit of length.

    Attributes:
        means: centres, [N, 3] float32.
        log_scales: logarithms of the standard deviations along the principal axes, [N, 3] float32.
        quaternions: orientation, wxyz, any length but zero, [N, 4] float32.
        opacity_logits: [N] float32.
        sh: spherical harmonics of the colour less one half, [N, (d + 1)^2, 3] float32, degree d from 0 to 3.
        input_pose: world-to-camera of the input view in that world, [4, 4]; the identity where it is the world.
        dropped: splats of the file that were left out, because a value was not finite.
    """

    means: Float32Array
    log_scales: Float32Array
    quaternions: Float32Array
    opacity_logits: Float32Array
    sh: Float32Array
    input_pose: Float64Array = field(default_factory=lambda: np.eye(4))
    dropped: int = 0

    def __post_init__(self) -> None:
        n = len(self.means)
        shapes = {"means": (n, 3), "log_scales": (n, 3), "quaternions": (n, 4), "opacity_logits": (n,)}
        for name, shape in shapes.items():
            if (given := getattr(self, name).shape) != shape:
                raise BadInput(f"splats with {name} of shape {given}", f"{shape}", "check the file")
        if self.sh.shape not in [(n, k, 3) for k in (1, 4, 9, 16)]:
            raise BadInput(f"splats with colours of shape {self.sh.shape}", "[N, 1, 4, 9 or 16, 3]", "check the file")

    def __len__(self) -> int:
        return len(self.means)

    @property
    def num_bytes(self) -> int:
        """Size of the arrays in bytes."""
        return sum(a.nbytes for a in (self.means, self.log_scales, self.quaternions, self.opacity_logits, self.sh))

    def usable(self) -> SplatCloud:
        """Without the splats that cannot be drawn: not finite, or without an orientation.

        An opacity logit of +-infinity is an opacity of 1 or 0 (VistaDream's files hold logit(1)) and is kept.

        Raises:
            BadInput: nothing is left, or there are more than `MAX_SPLATS`.
        """
        n = len(self)
        if n > MAX_SPLATS:
            raise BadInput(f"{n} splats", f"at most {MAX_SPLATS}", "thin the scene out")
        keep = np.ones(n, np.bool_)
        for array in (self.means, self.log_scales, self.quaternions, self.sh):
            keep &= np.isfinite(array).all(axis=tuple(range(1, array.ndim)))
        # exp(20) scene units, or an exp that overflows: a splat of that size is a broken one.
        keep &= (self.log_scales < 20).all(axis=1) & ~np.isnan(self.opacity_logits)
        keep &= np.linalg.norm(self.quaternions.astype(np.float64), axis=1) > 1e-12
        if not keep.any():
            raise BadInput(f"{n} splats, none of them finite", "splats that can be drawn", "export the scene again")
        if keep.all():
            return self
        parts = ("means", "log_scales", "quaternions", "opacity_logits", "sh")
        return replace(self, **{name: getattr(self, name)[keep] for name in parts}, dropped=n - int(keep.sum()))

    def scaled(self, factor: float) -> SplatCloud:
        """The same splats in a world ``factor`` times as large."""
        pose = self.input_pose.copy()
        pose[:3, 3] *= factor
        means = (self.means * np.float32(factor)).astype(np.float32)
        return replace(self, means=means, log_scales=self.log_scales + np.float32(math.log(factor)), input_pose=pose)

    def seen_from(self, input_pose: Float64Array) -> SplatCloud:
        """The same splats with another input view; raises `BadInput` for a pose that is not rigid."""
        R = input_pose[:3, :3]
        if not (np.isfinite(input_pose).all() and np.abs(R @ R.T - np.eye(3)).max() < 1e-3 and np.linalg.det(R) > 0):
            raise BadInput("an input view whose pose is not rigid", "a rotation and a translation", "check the file")
        return replace(self, input_pose=input_pose)

    def opacities(self) -> Float32Array:
        """Alpha at the centre, [N], in [0, 1]."""
        with np.errstate(over="ignore"):
            return (1.0 / (1.0 + np.exp(-self.opacity_logits.astype(np.float64)))).astype(np.float32)

    def colours(self, centre: Float64Array) -> Float32Array:
        """RGB >= 0 seen from a camera at ``centre`` [3], [N, 3] (Kerbl et al. 2023: 0.5 + harmonics, cut at 0)."""
        if self.sh.shape[1] == 1:
            rgb = 0.5 + SH_C0 * self.sh[:, 0]
        else:
            directions = self.means.astype(np.float64) - centre
            norms = np.linalg.norm(directions, axis=1, keepdims=True)
            basis = sh_basis(directions / np.maximum(norms, 1e-12), self.sh.shape[1]).astype(np.float32)
            rgb = 0.5 + np.einsum("nk,nkc->nc", basis, self.sh)
        return np.asarray(np.maximum(rgb, 0), np.float32)


def sh_basis(directions: Float64Array, count: int) -> Float64Array:
    """Real spherical harmonics in the order and with the signs of 3D Gaussian splatting files.

    Args:
        directions: unit vectors, [N, 3].
        count: 1, 4, 9 or 16 functions (degree 0 to 3).

    Returns:
        [N, count].
    """
    x, y, z = directions.T
    xx, yy, zz = x * x, y * y, z * z
    columns = [np.full_like(x, SH_C0)]
    if count > 1:
        columns += [-_C1 * y, _C1 * z, -_C1 * x]
    if count > 4:
        c20 = math.sqrt(5 / (16 * math.pi))
        columns += [_C2 * x * y, -_C2 * y * z, c20 * (2 * zz - xx - yy), -_C2 * x * z, 0.5 * _C2 * (xx - yy)]
    if count > 9:
        a, b, c = math.sqrt(35 / (32 * math.pi)), math.sqrt(105 / (4 * math.pi)), math.sqrt(21 / (32 * math.pi))
        d = math.sqrt(7 / (16 * math.pi))
        columns += [
            *(-a * y * (3 * xx - yy), b * x * y * z, -c * y * (4 * zz - xx - yy), d * z * (2 * zz - 3 * xx - 3 * yy)),
            *(-c * x * (4 * zz - xx - yy), 0.5 * b * z * (xx - yy), -a * x * (xx - 3 * yy)),
        ]
    return np.stack(columns, axis=1)
