"""The hash encoding at fixed rest positions."""

from __future__ import annotations

import pytest
import torch

from orca.config import HashConfig
from orca.errors import BadInput
from orca.field.hashing import HashEncoding


def _generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def _positions(count: int, seed: int = 1) -> torch.Tensor:
    return torch.rand(count, 2, generator=_generator(seed))


TWO_DENSE = HashConfig(levels=2, coarsest_resolution=4, finest_resolution=8)


def test_bilinear_interpolation_reproduces_linear_functions() -> None:
    """All vertices of both dense levels are read, so row r is vertex r: (x, y) = (r mod (n + 1), r div (n + 1))."""
    rest = torch.cat([_positions(500), torch.tensor([[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.25, 0.5]])])
    encoding = HashEncoding(rest, TWO_DENSE, _generator())
    assert encoding.table.shape == (5 * 5 + 9 * 9, 16)
    slopes = torch.randn(2, 3, 16, generator=_generator(2))
    with torch.no_grad():
        for level, (n, first) in enumerate([(4, 0), (8, 25)]):
            r = torch.arange((n + 1) ** 2)
            vertex = torch.stack([torch.ones(len(r)), r % (n + 1) / n, r // (n + 1) / n], 1)
            encoding.table[first : first + len(r)] = vertex @ slopes[level]
    at_rest = torch.cat([torch.ones(len(rest), 1), rest], 1)
    expected = torch.cat([at_rest @ slopes[0], at_rest @ slopes[1]], 1)
    torch.testing.assert_close(encoding(), expected, rtol=0, atol=1e-5)


def test_hashed_rows_follow_the_formula() -> None:
    """Coarse level dense (5 x 5 <= 64), fine level hashed: row = (x xor 2654435761 y) mod 64."""
    config = HashConfig(levels=2, log2_table_size=6, coarsest_resolution=4, finest_resolution=16)
    rest = _positions(2000)
    encoding = HashEncoding(rest, config, _generator())
    cell = (rest * 16).floor().long()
    expected = {
        int((x + dx) ^ ((y + dy) * 2654435761)) % 64 for x, y in cell.tolist() for dx in (0, 1) for dy in (0, 1)
    }
    assert len(expected) == 64  # every row is read, so compact rows are the rows: 25 dense, then 64 hashed
    assert len(encoding.table) == 25 + 64
    low = (cell[:, 0] ^ (cell[:, 1] * 2654435761)) % 64
    assert torch.equal(encoding.rows[:, 1, 0], low + 25)
    assert torch.equal(encoding.rows[:, 1, 1], ((cell[:, 0] + 1) ^ (cell[:, 1] * 2654435761)) % 64 + 25)


def test_the_default_pyramid_gives_32_features() -> None:
    encoding = HashEncoding(_positions(50), HashConfig(), _generator())
    assert encoding().shape == (50, 32)
    assert encoding.rows.shape == encoding.weights.shape == (50, 16, 4)


def test_weights_are_a_convex_combination_even_at_the_border() -> None:
    rest = torch.cat([_positions(100), torch.tensor([[0.0, 0.0], [1.0, 1.0], [0.0, 1.0], [-0.5, 2.0]])])
    encoding = HashEncoding(rest, HashConfig(), _generator())
    assert (encoding.weights >= 0).all()
    torch.testing.assert_close(encoding.weights.sum(-1), torch.ones(104, 16))
    outside, corner = encoding()[-1], encoding()[-2]
    assert torch.equal(outside, corner)  # clamped to (0, 1)


def test_only_rows_that_are_read_are_stored() -> None:
    encoding = HashEncoding(_positions(3), HashConfig(), _generator())
    assert len(encoding.table) == len(encoding.rows.unique()) <= 3 * 16 * 4
    encoding().sum().backward()
    assert encoding.table.grad is not None
    assert (encoding.table.grad.abs().sum(1) > 0).all()


def test_only_the_table_learns_and_positions_receive_nothing() -> None:
    rest = _positions(20).requires_grad_()
    encoding = HashEncoding(rest, HashConfig(), _generator())
    assert [name for name, _ in encoding.named_parameters()] == ["table"]
    assert not encoding.weights.requires_grad
    encoding().sum().backward()
    assert rest.grad is None
    assert set(encoding.state_dict()) == {"table", "rows", "weights"}


def test_same_seed_same_table() -> None:
    tables = [HashEncoding(_positions(40), HashConfig(), _generator(s)).table for s in (3, 3, 4)]
    assert torch.equal(tables[0], tables[1])
    assert not torch.equal(tables[0], tables[2])


def test_the_initial_table_is_uniform_within_its_bound() -> None:
    table = HashEncoding(_positions(2000), HashConfig(initial=1e-3), _generator()).table.detach()
    assert table.abs().max() <= 1e-3
    assert table.std().item() == pytest.approx(1e-3 / 3**0.5, rel=0.02)
    assert abs(table.mean().item()) < 2e-5


def test_neighbours_share_coarse_features_and_strangers_do_not() -> None:
    rest = torch.tensor([[0.30, 0.40], [0.3001, 0.4001], [0.9, 0.1]])
    features = HashEncoding(rest, HashConfig(), _generator())().detach()
    coarse = features[:, :2]
    assert (coarse[0] - coarse[1]).abs().max() < 1e-5
    assert (coarse[0] - coarse[2]).abs().max() > 1e-5
    assert (features[0] - features[1]).abs().max() > 1e-4  # fine levels tell the neighbours apart


@pytest.mark.parametrize("levels", [0, 1, 5, 33])
def test_levels_that_do_not_share_32_channels_are_rejected(levels: int) -> None:
    with pytest.raises(BadInput, match="a divisor of 32"):
        HashEncoding(_positions(2), HashConfig(levels=levels), _generator())
