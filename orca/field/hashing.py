"""Multi-resolution hash encoding read at fixed rest positions (METHOD.md 1, after Mueller et al. 2022)."""

from __future__ import annotations

import numba
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.autograd.function import FunctionCtx

from orca.anchors import FEATURE_DIM
from orca.config import HashConfig
from orca.conventions import Float32Array
from orca.errors import BadInput

__all__ = ["HashEncoding"]

_PRIMES = (1, 2654435761)


class HashEncoding(nn.Module):
    """Learnable features on a pyramid of 2D grids, looked up once and for all at the anchors' rest positions.

    Rest positions never move (not even when the means do), so the table rows and the bilinear weights are constants
    and the features are a constant sparse matrix times the table. No gradient flows to positions.

    Args:
        rest: rest positions in [0, 1]^2, [N, 2]; the canonical image coordinates of the canvas.
        config: levels, sizes and resolutions.
        generator: source of the initial table, uniform within +-``config.initial``.

    Raises `BadInput` if the levels do not share 32 channels evenly.
    """

    rows: Tensor
    weights: Tensor

    def __init__(self, rest: Tensor, config: HashConfig, generator: torch.Generator) -> None:
        super().__init__()
        if config.levels < 2 or FEATURE_DIM % config.levels:
            raise BadInput(
                f"a hash encoding of {config.levels} levels",
                f"a divisor of {FEATURE_DIM}, at least 2",
                "change `levels`",
            )
        growth = (config.finest_resolution / config.coarsest_resolution) ** (1 / (config.levels - 1))
        rows, weights, offset = [], [], 0
        for level in range(config.levels):
            resolution = round(config.coarsest_resolution * growth**level)
            size = min((resolution + 1) ** 2, 2**config.log2_table_size)
            level_rows, level_weights = _corners(rest.detach(), resolution, size)
            rows.append(level_rows + offset)
            weights.append(level_weights)
            offset += size
        # Only rows that some anchor reads are stored: the others can never receive a gradient.
        all_rows = torch.stack(rows, 1)
        touched, compact = torch.unique(all_rows, return_inverse=True)
        self.register_buffer("rows", compact.reshape(all_rows.shape).int())  # [N, levels, 4]
        self.register_buffer("weights", torch.stack(weights, 1))  # [N, levels, 4]
        start = (torch.rand(len(touched), FEATURE_DIM // config.levels, generator=generator) * 2 - 1) * config.initial
        self.table = nn.Parameter(start)

    def forward(self, index: Tensor | None = None) -> Tensor:
        """Features of all anchors, or of some, [N, 32]: per level, the bilinear mean of four table rows."""
        if self.table.device.type == "cpu" and self.table.dtype == torch.float32:
            chosen = torch.arange(len(self.rows)) if index is None else index
            features: Tensor = _Interpolate.apply(self.table, self.rows, self.weights, chosen)
            return features
        return self.formula(index)

    def formula(self, index: Tensor | None = None) -> Tensor:
        """The same in plain torch operations: what the compiled look-up is held to, and the path of other devices."""
        rows = self.rows if index is None else self.rows.index_select(0, index)
        weights = self.weights if index is None else self.weights.index_select(0, index)
        looked_up = self.table.index_select(0, rows.flatten().long()).view(*rows.shape, -1)  # [N, levels, 4, 2]
        return (looked_up * weights[..., None]).sum(2).flatten(1)


class _Interpolate(torch.autograd.Function):
    """The bilinear means of table rows, compiled: eager autograd moves ten times the memory."""

    @staticmethod
    def forward(ctx: FunctionCtx, table: Tensor, rows: Tensor, weights: Tensor, index: Tensor) -> Tensor:
        ctx.save_for_backward(rows, weights, index)
        ctx.size = table.shape  # type: ignore[attr-defined]
        out = torch.empty(len(index), rows.shape[1] * table.shape[1])
        arrays = (x.detach().numpy() for x in (table, rows, weights, index, out))
        _interpolate(*arrays)
        return out

    @staticmethod
    def backward(ctx: FunctionCtx, grad: Tensor) -> tuple[Tensor, None, None, None]:
        rows, weights, index = ctx.saved_tensors  # type: ignore[attr-defined]
        out = torch.zeros(ctx.size)  # type: ignore[attr-defined]
        arrays = (x.numpy() for x in (grad.contiguous(), rows, weights, index, out))
        _spread(*arrays)
        return out, None, None, None


# Between torch operations numba's own threads wait less than a pool's: torch's spin on the cores for a while.
@numba.njit(parallel=True, nogil=True, cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _interpolate(
    table: Float32Array,
    rows: NDArray[np.int32],
    weights: Float32Array,
    index: NDArray[np.int64],
    out: Float32Array,
) -> None:
    """Features [n, levels * C] of the anchors ``index`` [n], from table rows [N, levels, 4]."""
    levels, corners, width = rows.shape[1], rows.shape[2], table.shape[1]
    for j in numba.prange(len(index)):
        i = index[j]
        for level in range(levels):
            for c in range(width):
                total = np.float32(0)
                for k in range(corners):
                    total += weights[i, level, k] * table[rows[i, level, k], c]
                out[j, level * width + c] = total


@numba.njit(parallel=True, nogil=True, cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _spread(
    grad: Float32Array,
    rows: NDArray[np.int32],
    weights: Float32Array,
    index: NDArray[np.int64],
    out: Float32Array,
) -> None:
    """The transpose of `_interpolate`, added to ``out``. Levels share no row, so each is one core's own."""
    levels, corners, width = rows.shape[1], rows.shape[2], out.shape[1]
    for level in numba.prange(levels):
        for j in range(len(index)):
            i = index[j]
            for k in range(corners):
                for c in range(width):
                    out[rows[i, level, k], c] += weights[i, level, k] * grad[j, level * width + c]


def _corners(rest: Tensor, resolution: int, size: int) -> tuple[Tensor, Tensor]:
    """Table rows [N, 4] and bilinear weights [N, 4] of the four grid corners around each position."""
    scaled = rest.clamp(0, 1) * resolution
    low = scaled.floor().clamp(max=resolution - 1)
    fraction = scaled - low
    rows, weights = [], []
    for dy in (0, 1):
        for dx in (0, 1):
            x, y = low[:, 0].long() + dx, low[:, 1].long() + dy
            dense = (resolution + 1) ** 2 <= size
            rows.append(y * (resolution + 1) + x if dense else (x * _PRIMES[0] ^ y * _PRIMES[1]) % size)
            wx = fraction[:, 0] if dx else 1 - fraction[:, 0]
            wy = fraction[:, 1] if dy else 1 - fraction[:, 1]
            weights.append(wx * wy)
    return torch.stack(rows, 1), torch.stack(weights, 1).float()
