"""Decoders as plain matrices without the units that cannot matter.

A unit whose incoming or outgoing weights are all zero never changes the output; after the analytic initialisation
(METHOD.md 1.2) that is most of them. Leaving them out is exact, and whatever training brings to life stays in.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from orca.conventions import Float32Array
from orca.field.decoders import SH_DIM, Decoders

__all__ = ["CompactDecoders"]

_LANES = 8  # widths are padded to whole vectors, with zeros


@dataclass(frozen=True, eq=False)
class CompactDecoders:
    """The two decoders, each matrix [inputs, outputs].

    Attributes:
        density_in: [32, H].
        density: [H, 1 + G], the density first.
        from_geo: [1 + G, C]; the density's row is zero.
        from_direction: [16, C]; no rows if the direction is not used.
        middle: [C, D].
        last: [D, 3].
    """

    density_in: Float32Array
    density: Float32Array
    from_geo: Float32Array
    from_direction: Float32Array
    middle: Float32Array
    last: Float32Array

    @staticmethod
    def of(decoders: Decoders) -> CompactDecoders:
        """Matrices of the decoders as they are now."""
        with torch.no_grad():
            layers = [decoders.density_in, decoders.density_out, decoders.colour_in]
            density_in, density, colour_in = (_matrix(layer.weight) for layer in layers)
            middle, last = _matrix(decoders.colour_mid.weight), _matrix(decoders.colour_out.weight)
        from_geo = np.concatenate([np.zeros_like(colour_in[:1]), colour_in[SH_DIM:]])
        from_direction = colour_in[:SH_DIM] if decoders.use_direction else colour_in[:0]
        hidden = _alive(density_in) & _alive(density.T)
        geo = _alive(density) & _alive(from_geo.T)
        geo[0] = True
        outer = (_alive(from_geo) | _alive(from_direction)) & _alive(middle.T)
        inner = _alive(middle) & _alive(last.T)
        return CompactDecoders(
            _padded(density_in[:, hidden]),
            _padded(density[hidden][:, geo], rows=True),
            np.ascontiguousarray(from_geo[geo][:, outer]),
            np.ascontiguousarray(from_direction[:, outer]),
            np.ascontiguousarray(middle[outer][:, inner]),
            np.ascontiguousarray(last[inner]),
        )

    def sigma(self, carried: Float32Array) -> Float32Array:
        """Density [S] of aggregated first-layer outputs [S, H]."""
        logits = np.maximum(carried, 0) @ self.density[:, 0]
        return np.asarray(np.exp(np.minimum(logits - 1, 15)), np.float32)


def _matrix(weight: torch.Tensor) -> Float32Array:
    return np.asarray(weight.detach().cpu().numpy().T, np.float32)


def _alive(matrix: Float32Array) -> NDArray[np.bool_]:
    """Which columns have a weight that is not zero."""
    return np.asarray((matrix != 0).any(0))


def _padded(matrix: Float32Array, rows: bool = False) -> Float32Array:
    """Zero columns (or rows) up to a whole number of vectors; at least one."""
    axis = 0 if rows else 1
    missing = -matrix.shape[axis] % _LANES or (_LANES if matrix.shape[axis] == 0 else 0)
    widths = [(0, 0), (0, 0)]
    widths[axis] = (0, missing)
    return np.ascontiguousarray(np.pad(matrix, widths))
