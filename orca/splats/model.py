"""Plain 3D Gaussian splats: what public viewers know of a scene."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from orca.conventions import Float32Array
from orca.errors import BadInput

__all__ = ["Splats"]


@dataclass(frozen=True, eq=False)
class Splats:
    """N splats of one colour each.

    Attributes:
        means: centres in world units, [N, 3] float32.
        log_scales: logarithms of the standard deviations along the principal axes, [N, 3] float32.
        quaternions: orientation, wxyz, unit length, [N, 4] float32.
        colours: RGB, [N, 3] float32; in [0, 1] where they are to be kept in bytes.
        opacities: alpha at the centre, in (0, 1), [N] float32.
        stage: the `orca.anchors.Stage` of the anchor that each was baked from, [N] uint8.
    """

    means: Float32Array
    log_scales: Float32Array
    quaternions: Float32Array
    colours: Float32Array
    opacities: Float32Array
    stage: NDArray[np.uint8]

    def __post_init__(self) -> None:
        n = len(self.means)
        shapes = {"means": (n, 3), "log_scales": (n, 3), "quaternions": (n, 4), "colours": (n, 3)}
        for name, shape in {**shapes, "opacities": (n,), "stage": (n,)}.items():
            if (given := getattr(self, name).shape) != shape:
                raise BadInput(f"splats with {name} of shape {given}", f"{shape}", "check where they come from")

    def __len__(self) -> int:
        return len(self.means)

    def broken(self) -> int:
        """How many have a value that is not finite."""
        parts = [self.means, self.log_scales, self.quaternions, self.colours, self.opacities[:, None]]
        return int((~np.isfinite(np.concatenate(parts, axis=1))).any(axis=1).sum())

    def grown(self, growth: Float32Array) -> Splats:
        """Splats whose sizes are exp(growth) [N] times these."""
        return replace(self, log_scales=self.log_scales + growth[:, None].astype(np.float32))

    def axes(self) -> Float32Array:
        """R diag(s), [N, 3, 3]: its product with its own transpose is the covariance."""
        w, x, y, z = self.quaternions.T
        rows = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
        rotation = np.moveaxis(np.array(rows), -1, 0)
        return np.asarray(rotation * np.exp(self.log_scales)[:, None, :], np.float32)

    def covariances(self) -> Float32Array:
        """[N, 3, 3]."""
        axes = self.axes()
        return np.asarray(axes @ axes.transpose(0, 2, 1))
